"""Scans in, maps of objects out, on disk and back."""

from objgraph.estimate.task import Estimate
from objgraph.maps.entry import map_entry, with_trust
from objgraph.maps.lidar import LidarMappingConfig, map_lidar
from objgraph.maps.mapped_object import MappedObject
from objgraph.maps.object_map import ObjectMap
from objgraph.maps.of_graph import map_of
from objgraph.maps.pipeline import MappingConfig, map_scan, scene_floor, scene_points

__all__ = [
    "Estimate",
    "LidarMappingConfig",
    "MappedObject",
    "MappingConfig",
    "ObjectMap",
    "map_entry",
    "map_lidar",
    "map_of",
    "map_scan",
    "scene_floor",
    "scene_points",
    "with_trust",
]
