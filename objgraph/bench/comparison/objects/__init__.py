"""Methods on objects with a true shape."""
