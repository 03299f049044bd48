"""Best codes of shapes, of which all or one view is known."""
