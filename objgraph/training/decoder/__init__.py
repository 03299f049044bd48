"""Decoders and the codes of their training shapes."""
