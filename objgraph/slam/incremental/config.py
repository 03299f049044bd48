"""Settings of the incremental back-end."""

from dataclasses import dataclass, field

from factors import checks
from factors.checks import DEVIATIONS
from objgraph.errors import ConfigError
from objgraph.graph.builder import GraphConfig
from objgraph.graph.initialise import InitialisationConfig
from objgraph.graph.solve import LevenbergMarquardtConfig, SolverConfig
from objgraph.observation.sampling import SamplingConfig
from objgraph.slam.association import AssociationConfig
from objgraph.slam.odometry import OdometryNoise


@dataclass(frozen=True)
class Tolerance:
    """Changes since its linearisation at which an observation is linearised anew."""

    rotation: float = 0.01
    """Radians, of the object in the camera's frame."""
    translation: float = 0.005
    """Metres, of the object in the camera's frame."""
    log_scale: float = 0.01
    """Of each of the object's scales."""
    code: float = 0.1
    """Root mean square over the code, in standard deviations of the prior."""

    def __post_init__(self) -> None:
        """Raises ConfigError where one is not positive."""
        some = checks.POSITIVE
        checks.settings(self, ConfigError, rotation=some, translation=some, log_scale=some, code=some)


@dataclass(frozen=True)
class IncrementalConfig:
    """How frames become a map, one after the other."""

    graph: GraphConfig = field(default_factory=GraphConfig)
    sampling: SamplingConfig = field(default_factory=lambda: SamplingConfig(points=200, hits=120, free=120))
    """Of every observation; the information of a view does not grow with it."""
    odometry: OdometryNoise = field(default_factory=OdometryNoise)
    anchor_rotation: float = 1e-4
    """Standard deviation of the first camera's pose, radians."""
    anchor_translation: float = 1e-4
    """Standard deviation of the first camera's pose, metres."""
    association: AssociationConfig = field(default_factory=AssociationConfig)
    initialisation: InitialisationConfig = field(default_factory=InitialisationConfig)
    start: SolverConfig = field(default_factory=lambda: SolverConfig(rounds=4))
    """How a new object is solved before it enters."""
    rough: SolverConfig = field(default_factory=lambda: SolverConfig(slopes=(120.0,), rounds=1))
    """How an object is solved that is only to be recognised until it has been seen often enough."""
    tracking: SolverConfig = field(
        default_factory=lambda: SolverConfig(
            slopes=(120.0, 400.0), rounds=3, inner=LevenbergMarquardtConfig(iterations=4)
        )
    )
    """How a frame's camera and objects are solved against the map before they enter."""
    views_to_enter: int = 2
    """Views of an object before it enters the map."""
    baseline: float = 0.15
    """Radians between the directions from which an object was seen before it enters."""
    patience: int = 40
    """Frames after which an object that has not been seen again, and not entered, is given up."""
    tolerance: Tolerance = field(default_factory=Tolerance)
    refreshes: int = 8
    """Observations at most that an update linearises anew."""
    lag: float | None = None
    """Frames after which cameras are marginalised out; None keeps all."""
    seed: int = 0
    """Of everything that is sampled."""

    def __post_init__(self) -> None:
        """Raises ConfigError where a number is not one of its kind."""
        checks.settings(
            self, ConfigError, anchor_rotation=DEVIATIONS, anchor_translation=DEVIATIONS,
            views_to_enter=checks.Range(1), lag=checks.POSITIVE,
        )  # fmt: skip
