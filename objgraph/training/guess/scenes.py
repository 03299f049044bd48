"""Rendered views of an object of which everything is known: what a first guess learns from.

A shape of a category's, as large as its objects are, stands on a floor, perhaps before a wall, beside, behind and under other
things, and is seen by a person who walks about it with a camera that has the faults of `objgraph.synthetic.faults`.
"""

from dataclasses import dataclass, replace

import numpy as np
import trimesh
from jaxtyping import Float
from numpy.random import Generator

from factors import checks
from factors.priors import scale_covariance
from objgraph.errors import ConfigError, ObservationError
from objgraph.geometry.frames import look_at, upright_axes
from objgraph.observation.sampling import ObjectView, SamplingConfig, observe
from objgraph.priors.shape_prior import ShapePrior
from objgraph.synthetic.camera import Pose
from objgraph.synthetic.faults import HARD, FaultRanges, Faults
from objgraph.synthetic.furniture import Furniture
from objgraph.synthetic.photograph import dark_places, photograph
from objgraph.synthetic.render import Renderer
from objgraph.synthetic.scene import PlacedFurniture
from objgraph.synthetic.sensor import SensorConfig

VIEWS = 3
UP = np.array([0.0, 0.0, 1.0])
UP.flags.writeable = False
_TARGET = 1
_HEIGHT_M = (1.0, 1.8)
_LEAST_M = 0.6
"""Between a camera and the object's footprint."""
_RAISED_M = (0.0, 1.2)
"""How far above the floor what need not stand on it is."""


ANY_SCAN = replace(HARD, sensor=(0.5, 2.0), mask_border_px=(0.5, 8.0), apart_deg=(5.0, 60.0))
"""Strengths of faults from next to none to those of the hardest scans."""


@dataclass(frozen=True)
class SceneConfig:
    """How scenes are drawn."""

    faults: FaultRanges = ANY_SCAN
    things: int = 4
    """Other things about the object, at most."""
    wall: float = 0.5
    """Share of the objects that stand before a wall."""
    proportions: float = 0.05
    """Standard deviation of the logarithm of each edge about the shape's own proportions."""

    def __post_init__(self) -> None:
        """Raises ConfigError where a number is not one of its kind."""
        checks.settings(self, ConfigError, wall=checks.SHARES)


@dataclass(frozen=True)
class SeenObject:
    """Up to three views of one object, and where it is."""

    views: tuple[ObjectView, ...]
    floor: float | None
    """The floor's height as it is measured; None for what need not stand on it."""
    T_world_object: Float[np.ndarray, "4 4"]
    """Upright: y along the world's z."""
    scale: Float[np.ndarray, "3"]
    """Metres per canonical unit."""


def draw_seen(
    mesh: trimesh.Trimesh,
    extents: Float[np.ndarray, "3"],
    prior: ShapePrior,
    config: SceneConfig,
    rng: Generator,
) -> SeenObject | None:
    """Views of a shape; None where fewer than two of three show enough of it.

    The mesh is in the prior's canonical frame; `extents` are the edges of its box before it was stretched to the prior's,
    whose diagonal is 1.
    """
    faults = config.faults.draw(rng)
    noise = rng.multivariate_normal(np.zeros(3), scale_covariance(prior.size_log_sigma, config.proportions))
    half = 0.5 * prior.size_mean * extents * np.exp(noise)
    scale = 2 * half / (mesh.extents if prior.box is None else prior.box)
    T_world_object = np.eye(4)
    T_world_object[:3, :3] = upright_axes(UP, rng.uniform(-np.pi, np.pi))
    T_world_object[2, 3] = half[1] + (0.0 if prior.stands else rng.uniform(*_RAISED_M))
    piece = Furniture("chair", "drawn", mesh, prior.size_mean, 1)
    target = PlacedFurniture(piece, T_world_object, scale)
    bearing = rng.uniform(-np.pi, np.pi)
    reach = float(np.hypot(half[0], half[2]))
    things = [_thing(half, reach, bearing, rng) for _ in range(rng.integers(config.things + 1))]
    shell = [_slab((12.0, 12.0, 0.1), (0.0, 0.0, -0.05))]
    if rng.random() < config.wall:
        away = -_level(bearing + rng.uniform(-1.2, 1.2))
        shell.append(_slab((0.1, 8.0, 2.6), (*(away * (reach * rng.uniform(0.75, 1.6) + 0.05)), 1.3), away))
    renderer = Renderer([target, *things], shell, rng, colored=False)
    dark = dark_places(target.p_world[mesh.faces], faults.holes, rng)
    views = []
    for k, pose in enumerate(_cameras(T_world_object[2, 3], reach, bearing, faults, rng)):
        seen = photograph(renderer, pose, 0.0, dark, _TARGET, faults, SensorConfig(), str(k), rng)
        try:
            views.append(observe(seen.frame, _TARGET, SamplingConfig(), seed=int(rng.integers(2**31))))
        except ObservationError:  # hidden, or out of the picture
            continue
    if len(views) < 2:
        return None
    floor = faults.floor_m if prior.stands else None
    return SeenObject(tuple(views), floor, T_world_object, scale)


def _thing(half: np.ndarray, reach: float, bearing: float, rng: Generator) -> PlacedFurniture:
    """A box on the floor about the object, in front of it above all, or on or over it."""
    size = np.exp(rng.normal(np.log([0.35, 0.4, 0.35]), 0.6))
    if rng.random() < 0.25:
        size, at = 0.6 * size, rng.uniform(-0.8, 0.8, 2) * half[[0, 2]]
        low = 2 * half[1] * rng.uniform(0.3, 1.0)
    else:
        away = reach * rng.uniform(0.5, 1.3) + 0.5 * float(np.hypot(size[0], size[2]))
        at, low = away * _level(bearing + rng.normal(0, 1.0)), 0.0
    # a table top to be pushed under, some of the time
    if rng.random() < 0.25:
        size, low = size * [2.0, 0.1, 2.0], rng.uniform(0.6, 0.8)
    T = np.eye(4)
    T[:3, :3] = upright_axes(UP, rng.uniform(-np.pi, np.pi))
    T[:3, 3] = [*at, low + size[1] / 2]
    mesh = trimesh.creation.box(size / np.linalg.norm(size))
    return PlacedFurniture(Furniture("chair", "box", mesh, 1.0, 1), T, np.full(3, np.linalg.norm(size)))


def _cameras(middle_m: float, reach: float, bearing: float, faults: Faults, rng: Generator) -> list[Pose]:
    """A walk about the object, or past it."""
    side, height = rng.choice([-1.0, 1.0]), rng.uniform(*_HEIGHT_M)
    # what is large is seen from farther off
    level = max(faults.distance_m, reach * rng.uniform(1.2, 2.5) + _LEAST_M)
    aim = np.array([0.0, 0.0, middle_m]) + rng.normal(0, faults.aim_m, 3) * [1, 1, 0.5]
    poses = []
    for k in range(VIEWS):
        eye = level * _level(bearing + side * k * np.radians(0 if faults.walk else faults.apart_deg))
        if faults.walk:
            eye = eye + side * k * faults.walk_m * _level(bearing + np.pi / 2)
        at = np.array([*eye, height]) + rng.normal(0, 0.05, 3)
        poses.append(look_at(at, aim + rng.normal(0, 0.05, 3), UP))
    return poses


def _level(bearing: float) -> Float[np.ndarray, "2"]:
    return np.array([np.cos(bearing), np.sin(bearing)])


def _slab(
    size: tuple[float, float, float], middle: tuple[float, ...], along: np.ndarray | None = None
) -> trimesh.Trimesh:
    """A box in the world, its x axis along a level direction."""
    T = np.eye(4)
    if along is not None:
        T[:2, :2] = np.stack([along, [-along[1], along[0]]], axis=1)
    T[:3, 3] = middle
    return trimesh.creation.box(size, T)
