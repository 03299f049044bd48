"""Robots' recordings: see `load`."""

from objgraph.datasets.bag.load import load, scenes

__all__ = ["load", "scenes"]
