"""From a LiDAR scan and a detected box to what the factors take: surface points and rays."""

from dataclasses import dataclass, field

import gtsam
import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial import cKDTree

from factors import checks
from factors.checks import PLACES
from factors.rays import Rays
from objgraph.errors import ConfigError, ObservationError
from objgraph.geometry.frames import transformed
from objgraph.observation.lidar.frame import Detection, LidarFrame
from objgraph.observation.lidar.road import Road
from objgraph.observation.masks import of_one_object
from objgraph.observation.sampling import ObjectView, SensorNoise


@dataclass(frozen=True)
class LidarSamplingConfig:
    """How a scan is sampled about a detected object."""

    points: int = 300
    """Surface points, and as many rays that end on the object, at most."""
    free: int = 150
    """Rays that pass beside the object, at most."""
    least: int = 15
    """Returns from the object below which it cannot be estimated."""
    margin: float = 0.4
    """A return this far outside of the detected box may still be the object's, metres."""
    clearance: float = 0.12
    """Returns lower than this over the road are the road's, metres."""
    gap: float = 0.5
    """Small parts of an object's returns farther than this from the rest are not of it, metres."""
    cell: float = 0.25
    """Returns within two of these of each other hang together, metres."""
    beside: float = 0.7
    """Rays that pass the object's returns by more than this say little of it, metres at its distance."""
    beam: float = 0.0015
    """Radians by which a beam's direction is uncertain: its width."""
    correlation_length: float = 0.2
    """Metres: surface closer than this errs together, so each cube of that size is one independent measurement."""
    noise: SensorNoise = field(default_factory=lambda: SensorNoise(base=0.02, quadratic=0.0))

    def __post_init__(self) -> None:
        """Raises ConfigError where a number is not one of its kind."""
        some, metres = checks.Range(1), checks.Range(1e-3, 1e4)
        checks.settings(
            self, ConfigError, points=some, least=checks.Range(3), cell=metres, beam=checks.Range(0, 1),
            correlation_length=metres,
        )  # fmt: skip


def observe_lidar(
    frame: LidarFrame,
    detection: Detection,
    road: Road | None = None,
    config: LidarSamplingConfig | None = None,
    seed: int = 0,
) -> ObjectView:
    """Sample what a scan says about a detected object.

    A return on the object is a surface point and a ray that ends there. A return from behind it leaves the object's
    place free along its ray; one from before it is an occluder's and says nothing of the object. Where nothing came
    back nothing is known. With masks, returns on the object's mask alone are the object's, and what passes within the
    mask (through a window) says nothing.

    Raises:
        ObservationError: the box is behind the LiDAR, or too few returns are in it; the message names the frame and
            the object.
    """
    config = checks.settings_or_default(config, LidarSamplingConfig, ConfigError)
    checks.instance("frame", frame, LidarFrame, ObservationError)
    checks.instance(f"frame {frame.name}: detection", detection, Detection, ObservationError)
    where = f"frame {frame.name}, {detection.name}"
    ahead = frame.p_lidar[:, 2] > 0.5
    p_lidar = frame.p_lidar[ahead & (np.abs(frame.p_lidar) < PLACES.most).all(axis=1)]
    T = frame.T_world_lidar
    p_world = transformed(T, p_lidar)
    if (detection.T_world_object[:3, 3] - T[:3, 3]) @ T[:3, 2] < 0.5:
        raise ObservationError(f"{where}: the detected box is not ahead of the LiDAR; leave it out")
    ids = frame.picture.ids_at(p_world) if frame.picture is not None else np.full(len(p_world), -1)
    own = _own(frame, detection, p_world, ids, road, config)
    if (count := np.count_nonzero(own)) < config.least:
        masked = f" and on its mask (pixels of the value {detection.id})" if (ids != -1).any() else ""
        what = f"{count} returns are in the detected box{masked}, at least {config.least} are due"
        raise ObservationError(f"{where}: {what}")
    rng = np.random.default_rng(seed)
    points = p_lidar[own]
    points = points[rng.permutation(len(points))[: config.points]]
    beside = p_lidar[
        _beside(p_lidar, own, (ids == detection.id) | _near_box(detection, p_world, config), config)
    ]
    beside = beside[rng.permutation(len(beside))[: config.free]]
    return ObjectView(
        frame.name,
        gtsam.Pose3(T),
        points,
        config.noise(np.linalg.norm(points, axis=1)),
        _rays(points, beside, config),
        config.correlation_length,
    )


def _own(
    frame: LidarFrame,
    detection: Detection,
    p_world: Float[np.ndarray, "n 3"],
    ids: np.ndarray,
    road: Road | None,
    config: LidarSamplingConfig,
) -> Bool[np.ndarray, "n"]:
    """Which returns come from the object: in or near its box, in no other's more, above the road."""
    outside = detection.outside(p_world)
    own = outside < config.margin
    for other in (*frame.detections, *frame.others):
        if other.id != detection.id:
            own &= outside <= other.outside(p_world)
    if road is not None:
        own &= road.above(p_world) > config.clearance
    own &= (ids == detection.id) | (ids == -1)
    indices = np.flatnonzero(own)
    own[indices] = of_one_object(p_world[indices], config.gap, config.cell)
    return own


def _near_box(
    detection: Detection, p_world: Float[np.ndarray, "n 3"], config: LidarSamplingConfig
) -> Bool[np.ndarray, "n"]:
    """Returns that might be the object's though they were not taken for its own."""
    return detection.outside(p_world) < config.margin


def _beside(
    p_lidar: Float[np.ndarray, "n 3"],
    own: Bool[np.ndarray, "n"],
    unclear: Bool[np.ndarray, "n"],
    config: LidarSamplingConfig,
) -> Bool[np.ndarray, "n"]:
    """Returns whose rays pass near the object's own, and end behind where these do."""
    distance = np.linalg.norm(p_lidar, axis=1)
    directions = p_lidar / distance[:, None]
    gap, nearest = cKDTree(directions[own]).query(directions)
    behind = distance > distance[own][nearest]
    return ~own & ~unclear & behind & (gap * np.median(distance[own]) < config.beside)


def _rays(
    points: Float[np.ndarray, "n 3"], beside: Float[np.ndarray, "m 3"], config: LidarSamplingConfig
) -> Rays:
    ends = np.concatenate([points, beside])
    directions = ends / ends[:, 2:]
    hit = np.arange(len(ends)) < len(points)
    nearest = cKDTree(directions[hit]).query(directions)[1]
    depth = points[nearest, 2]
    end = np.where(hit, np.inf, ends[:, 2])
    length = np.linalg.norm(directions, axis=1) * depth
    sigma = np.hypot(config.noise(length), config.beam * length)
    return Rays(directions, depth, hit, end, sigma)
