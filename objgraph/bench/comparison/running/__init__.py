"""Rows made in processes and kept on disk."""
