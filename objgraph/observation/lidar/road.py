"""The road under a detected object: a plane through the returns about it."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from factors import checks
from objgraph.errors import ConfigError
from objgraph.observation.lidar.frame import Detection


@dataclass(frozen=True)
class RoadConfig:
    """Where the road is looked for, and what is taken for it."""

    reach: float = 5.0
    """Level distance from the object's box within which returns count, metres."""
    below: float = 1.0
    """How far under the detected box the road may lie, metres."""
    above: float = 0.6
    """How far above the detected box' lower side it may lie, metres."""
    thickness: float = 0.08
    """Returns this near to a plane are on it, metres."""
    tilt: float = 0.12
    """Radians that the road may lean against the level."""
    least: int = 25
    """Returns on it below which there is no road to be seen."""
    draws: int = 200
    """Planes tried."""
    roughness: float = 0.05
    """Standard deviation of returns, independent ones, about the plane, metres."""
    cell: float = 0.5
    """Returns within one such cell are one measurement, metres."""
    slope_sigma: float = 0.03
    """How far roads lean, radians: what few returns on a narrow strip leave open."""

    def __post_init__(self) -> None:
        """Raises ConfigError where a number is not one of its kind."""
        metres = checks.Range(1e-3, 1e4)
        checks.settings(
            self, ConfigError, thickness=metres, least=checks.Range(3), draws=checks.Range(1, 10_000),
            roughness=metres, cell=metres, slope_sigma=checks.Range(1e-4, 10),
        )  # fmt: skip


@dataclass(frozen=True)
class Road:
    """The plane `normal_world . p = height` near one object."""

    normal_world: Float[np.ndarray, "3"]
    """Unit, upwards."""
    height: float
    """Metres along the normal."""

    def above(self, p_world: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n"]:
        """Height of points over the road, metres."""
        return p_world @ self.normal_world - self.height


def road_under(
    p_world: Float[np.ndarray, "n 3"],
    up_world: Float[np.ndarray, "3"],
    detection: Detection,
    config: RoadConfig | None = None,
    seed: int = 0,
) -> Road | None:
    """The plane of most returns about the object and under its middle; None where too few lie on any.

    Of planes through three random returns the one with the most on it, fitted again to these.
    """
    config = checks.settings_or_default(config, RoadConfig, ConfigError)
    in_box = detection.to_box(p_world)
    away = np.abs(in_box) - detection.size / 2
    low = in_box[:, 1] + detection.size[1] / 2
    level = np.maximum(away[:, 0], away[:, 2])
    # not those under the car itself: they are few, and its own underside is among them
    near = (level > 0.2) & (level < config.reach) & (low > -config.below) & (low < config.above)
    points = p_world[near]
    if len(points) < config.least:
        return None
    middle = points.mean(axis=0)
    local = points - middle
    normals, heights = _planes(local, np.asarray(up_world, float), config, seed)
    if not len(normals):
        return None
    distances = np.abs(local @ normals.T - heights)
    on_plane = distances[:, np.argmax((distances < config.thickness).sum(axis=0))] < config.thickness
    if np.count_nonzero(on_plane) < config.least:
        return None
    return _fitted(local[on_plane], middle, np.asarray(up_world, float), config)


def _fitted(
    local: Float[np.ndarray, "n 3"],
    middle: Float[np.ndarray, "3"],
    up_world: Float[np.ndarray, "3"],
    config: RoadConfig,
) -> Road:
    """Least squares of heights over the level plane, with roads' usual slopes as prior."""
    across = np.linalg.svd(up_world[None])[2][1:]
    level, height = local @ across.T, local @ up_world
    share = len(np.unique(np.floor(level / config.cell), axis=0)) / len(level)
    rows = np.column_stack([level, np.ones(len(level))])
    information = share / config.roughness**2 * rows.T @ rows + np.diag([config.slope_sigma**-2] * 2 + [0.0])
    slope_a, slope_b, offset = np.linalg.solve(information, share / config.roughness**2 * rows.T @ height)
    normal = up_world - slope_a * across[0] - slope_b * across[1]
    length = np.linalg.norm(normal)
    return Road(normal / length, float((normal @ middle + offset) / length))


def _planes(
    local: Float[np.ndarray, "n 3"], up_world: Float[np.ndarray, "3"], config: RoadConfig, seed: int
) -> tuple[Float[np.ndarray, "k 3"], Float[np.ndarray, "k"]]:
    """Upward normals and heights of planes through three random points each, of those that lie about level."""
    # not open3d's segment_plane: it loses the road beside a larger wall, and more threads than one outrun its seed
    rng = np.random.default_rng(seed)
    a, b, c = local[rng.integers(len(local), size=(3, config.draws))]
    normals = np.cross(b - a, c - a)
    length = np.linalg.norm(normals, axis=1)
    wide = length > 0.1
    a, normals = a[wide], normals[wide] / length[wide, None]
    normals *= np.sign(normals @ up_world)[:, None]
    level = normals @ up_world > np.cos(config.tilt)
    return normals[level], (a[level] * normals[level]).sum(axis=1)
