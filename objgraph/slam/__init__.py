"""Objects and cameras together: association, maps that grow frame by frame, odometry."""

from objgraph.slam.incremental.config import IncrementalConfig
from objgraph.slam.incremental.front_end import FrameReport
from objgraph.slam.incremental.object_graph import IncrementalObjectGraph
from objgraph.slam.incremental.own_smoother import ObjectFrontEnd, Step
from objgraph.slam.odometry import OdometryNoise, dead_reckoning, drifting_motions

__all__ = [
    "FrameReport",
    "IncrementalConfig",
    "IncrementalObjectGraph",
    "ObjectFrontEnd",
    "OdometryNoise",
    "Step",
    "dead_reckoning",
    "drifting_motions",
]
