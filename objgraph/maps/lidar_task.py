"""From a detection to what an estimator is given: views, road, start."""

from dataclasses import dataclass, field

import gtsam
import numpy as np

from factors import checks
from factors.checks import DEVIATIONS
from factors.depth import RaySampling
from factors.state import ObjectState
from objgraph.errors import ConfigError
from objgraph.estimate.task import EstimationTask
from objgraph.graph.builder import DetectedBox, GraphConfig
from objgraph.observation.lidar.frame import Detection, LidarFrame
from objgraph.observation.lidar.observe import LidarSamplingConfig, observe_lidar
from objgraph.observation.lidar.road import RoadConfig, road_under
from objgraph.priors.shape_prior import ShapePrior


@dataclass(frozen=True)
class DetectorNoise:
    """How far a detector's boxes are off, one standard deviation."""

    position: float = 0.3
    """Metres, along each axis."""
    heading_deg: float = 8.0
    size: float = 0.08
    """Of the logarithm of each edge."""

    def __post_init__(self) -> None:
        """Raises ConfigError where one is not positive."""
        some = DEVIATIONS
        checks.settings(self, ConfigError, position=some, heading_deg=some, size=some)


@dataclass(frozen=True)
class LidarTaskConfig:
    """How a detection becomes an object to be estimated."""

    sampling: LidarSamplingConfig = field(default_factory=LidarSamplingConfig)
    road: RoadConfig = field(default_factory=RoadConfig)
    detector: DetectorNoise = field(default_factory=DetectorNoise)

    def __post_init__(self) -> None:
        """Raises ConfigError where one is of another kind."""
        checks.settings(self, ConfigError)


ROADS = GraphConfig(
    upright_sigma=0.05,
    floor_sigma=0.05,
    floor_spacing=0.3,
    surface_tail=None,
    tight_box=True,
    sides=None,
    sampling=RaySampling(coarse=8, cells=8),
)
"""Roads are known less well than floors: a few returns on each, neither they nor the wheels are even; and a car is larger
than a chair and no cube. Its points come of no mask. Its shape is not held to its box: of few returns that makes what one scan hardly shows look known
(docs/decisions/2026-11-kitti.md)."""


def task_of(
    frame: LidarFrame,
    detection: Detection,
    prior: ShapePrior,
    config: LidarTaskConfig | None = None,
    seed: int = 0,
) -> EstimationTask:
    """The object as one scan shows it; it starts as the prior's mean shape in the detected box.

    Up is the road's normal, where the road is seen, and the floor the road's height; the frame's own up otherwise.

    Raises:
        ObservationError: the box is not ahead of the LiDAR, or too few returns are in it.
    """
    config = config or LidarTaskConfig()
    road = road_under(frame.p_world, frame.up_world, detection, config.road, seed)
    view = observe_lidar(frame, detection, road, config.sampling, seed)
    box = DetectedBox(
        gtsam.Pose3(detection.T_world_object),
        detection.size,
        config.detector.position,
        np.radians(config.detector.heading_deg),
        config.detector.size,
    )
    start = ObjectState(box.T_world_object, box.log_scale(prior), np.array(prior.code_mean, float))
    return EstimationTask(
        f"frame {frame.name}, {detection.name}",
        prior,
        (start,),
        (view,),
        frame.up_world if road is None else road.normal_world,
        None if road is None else road.height,
        box,
    )
