"""Methods on objects whose truth is a box."""
