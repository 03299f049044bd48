"""The factor graph: what goes into it, where it begins, how it is solved."""
