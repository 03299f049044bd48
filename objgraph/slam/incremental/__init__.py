"""Maps that grow frame by frame."""
