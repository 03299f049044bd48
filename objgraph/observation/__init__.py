"""From pixels or returns to what factors take."""

from objgraph.observation.frames import Frame, FrameSource, Instance, Intrinsics, ListedFrames, Scan
from objgraph.observation.lidar.observe import observe_lidar
from objgraph.observation.lidar.road import road_under
from objgraph.observation.sampling import ObjectView, SamplingConfig, observe
from objgraph.observation.view_selection import summarize

__all__ = [
    "Frame",
    "FrameSource",
    "Instance",
    "Intrinsics",
    "ListedFrames",
    "ObjectView",
    "SamplingConfig",
    "Scan",
    "observe",
    "observe_lidar",
    "road_under",
    "summarize",
]
