"""Collected meshes as solids, and signed distances sampled of them."""
