"""Objects of families that no prior knows, in rooms of their own."""
