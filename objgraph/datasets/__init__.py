"""Loaders of data sets: one file each, found by name."""

from objgraph.datasets.registry import Loader, datasets, load_scan, register, scenes

__all__ = ["Loader", "datasets", "load_scan", "register", "scenes"]
