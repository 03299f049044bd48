"""Loaders of data sets: one file each, found by name."""

from objgraph.datasets.registry import Loader, datasets, load_lidar_frame, load_scan, register, scenes
from objgraph.datasets.trajectory import Trajectory, absolute_trajectory_error, write_tum

__all__ = [
    "Loader",
    "Trajectory",
    "absolute_trajectory_error",
    "datasets",
    "load_lidar_frame",
    "load_scan",
    "register",
    "scenes",
    "write_tum",
]
