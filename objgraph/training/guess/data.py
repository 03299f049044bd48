"""Rendered views of a prior's shapes, drawn by several processes and kept: what a first guess is trained on."""

from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import torch
import trimesh
from jaxtyping import Bool, Float
from numpy.random import Generator
from safetensors import SafetensorError
from safetensors.numpy import load_file, save

from objgraph.atomic import write_file
from objgraph.errors import PriorError, SolveError
from objgraph.geometry.symmetry import SAME, turn_gaps
from objgraph.observation.clouds import ViewCloud, clouds, view_cloud
from objgraph.observation.gravity_box import smallest_heading
from objgraph.priors.first_guess import FirstGuessConfig, place_in
from objgraph.priors.mesh import extract_mesh
from objgraph.priors.shape_prior import ShapePrior
from objgraph.training.guess.scenes import UP, VIEWS, SceneConfig, SeenObject, draw_seen
from objgraph.work import in_order, process_pool

_SURFACE, _FREE = 200, 100
"""Points kept of a view."""
TURNS = 16
_TURNS = 2 * np.pi * np.arange(TURNS) / TURNS
_AS_GOOD = 0.01
"""Gap between a shape and itself turned, in its diagonals, at which the turn is about as good."""
_MESH_RESOLUTION = 56


@dataclass(frozen=True)
class Shape:
    """A shape to render."""

    name: str
    extents: Float[np.ndarray, "3"] | None
    """Edges of its box, whose diagonal is 1; None where they are those of what the prior makes of the code."""
    code: Float[np.ndarray, "l"] | None = None
    mesh: trimesh.Trimesh | None = None
    """In its own proportions; without one it is what the prior makes of the code."""
    source: str = ""
    """Where the mesh is from."""

    def in_prior(self, prior: ShapePrior) -> trimesh.Trimesh:
        """Its mesh in the prior's canonical frame. Raises SolveError where the code has no surface."""
        if self.mesh is None:
            assert self.code is not None
            return extract_mesh(prior.decoder, self.code, _MESH_RESOLUTION)
        box = self.extents if prior.box is None else prior.box
        stretch = np.ones(3) if box is None else box / self.mesh.extents
        return _scaled(self.mesh, stretch)


@dataclass(frozen=True)
class Draws:
    """What was seen of some objects, each in three views at most."""

    surface: Float[np.ndarray, "n v p 3"]
    normal: Float[np.ndarray, "n v p 3"]
    free: Float[np.ndarray, "n v q 3"]
    eye: Float[np.ndarray, "n v 3"]
    views: np.ndarray
    """How many each has."""
    floor: Float[np.ndarray, "n"]
    """Its measured height; NaN for what need not stand on it."""
    T_world_object: Float[np.ndarray, "n 4 4"]
    log_scale: Float[np.ndarray, "n 3"]
    gaps: Float[np.ndarray, "n 16"]
    """Between each and itself turned by sixteenths of a full turn, in its diagonals (`objgraph.geometry.symmetry`)."""
    shape: np.ndarray
    """Which shape it is of."""

    def __len__(self) -> int:
        return len(self.views)


@dataclass(frozen=True)
class Batch:
    """What the network is given, and what it should say."""

    points: Float[torch.Tensor, "b h p 11"]
    size: Float[torch.Tensor, "b h 3"]
    weight: Float[torch.Tensor, "b h"]
    """How good each heading is; sums to one."""
    place: Float[torch.Tensor, "b h 7"]
    """Heading, centre and log-scale in the frame of each, as if the object stood at it."""
    off: Float[torch.Tensor, "b h"]
    """Its heading's angle from each, radians within half a turn."""
    alike: Bool[torch.Tensor, "b 16"]
    """By which sixteenths of a turn each object can be turned and looks the same."""
    shape: np.ndarray


def draw_all(
    shapes: Sequence[Shape],
    prior: ShapePrior,
    each: int,
    config: SceneConfig,
    seed: int,
    cache: Path,
    jobs: int = 1,
    progress: Callable[[int, int], None] | None = None,
) -> Draws:
    """Draw `each` scenes of every shape, or read them back; shapes without a surface are left out.

    Raises:
        PriorError: none is left.
    """
    work = partial(_drawn, prior=prior, each=each, config=config, seed=seed, cache=cache)
    parts: list[dict[str, np.ndarray]] = []
    with process_pool(jobs, PriorError, "fork", partial(_inherit, work, shapes)) as pool:
        for i, part in enumerate(in_order(pool, (partial(_inherited, i) for i in range(len(shapes))))):
            if part:
                count = len(part["views"])
                parts.append({**part, "shape": np.full(count, i)})
            if progress is not None:
                progress(i + 1, len(shapes))
    if not parts:
        raise PriorError(f"of {len(shapes)} shapes of the {prior.category} prior none is seen in any scene")
    return Draws(**{key: np.concatenate([part[key] for part in parts]) for key in parts[0]})


@dataclass(frozen=True)
class Look:
    """One draw as it is looked at."""

    seen: list[ViewCloud]
    T_world_object: Float[np.ndarray, "4 4"]
    gaps: Float[np.ndarray, "16"]
    """Between the shape and itself turned by sixteenths, in its diagonals."""
    start: float
    """The first of the headings that the network looks at, radians."""


def first_views(count: int) -> Callable[[Draws, int], Look]:
    """Draws by their first so many views, at the headings that a first guess looks at."""

    def look(draws: Draws, i: int) -> Look:
        seen = _clouds(draws, i, range(min(int(draws.views[i]), count)), np.eye(4))
        start = smallest_heading(np.concatenate([view.surface for view in seen]), UP)
        return Look(seen, draws.T_world_object[i], draws.gaps[i], start)

    return look


def varied(rng: Generator) -> Callable[[Draws, int], Look]:
    """Draws for training: by one to three views, at any headings, and half of them in a mirror."""

    def look(draws: Draws, i: int) -> Look:
        there = int(draws.views[i])
        count = min(there, int(rng.integers(1, VIEWS + 1)))
        some = rng.permutation(there)[:count]
        mirror, gaps = np.eye(4), draws.gaps[i]
        if rng.random() < 0.5:
            mirror[0, 0] = -1.0
            gaps = np.roll(gaps[::-1], 1)
        seen = _clouds(draws, i, some, mirror)
        return Look(seen, mirror @ draws.T_world_object[i] @ mirror, gaps, rng.uniform(0, 2 * np.pi))

    return look


def _clouds(draws: Draws, i: int, views: Iterable[int], mirror: Float[np.ndarray, "4 4"]) -> list[ViewCloud]:
    arrays = draws.surface, draws.normal, draws.free, draws.eye
    return [ViewCloud(*(array[i, k].astype(float) @ mirror[:3, :3] for array in arrays)) for k in views]


def batch(
    draws: Draws,
    rows: Sequence[int],
    unit: float,
    config: FirstGuessConfig,
    rng: Generator,
    look: Callable[[Draws, int], Look],
) -> Batch:
    """Clouds of some draws, looked at one way or another; `rng` chooses their points."""
    points, sizes, weights, places, offs, alike = [], [], [], [], [], []
    for i in rows:
        one = look(draws, i)
        floor = None if np.isnan(draws.floor[i]) else float(draws.floor[i])
        made = clouds(one.seen, UP, floor, unit, config.at(one.start), config.surface, config.free, rng)
        place = place_in(made.box, unit, one.T_world_object, draws.log_scale[i])
        own = int(np.abs(place[:, 0]).argmin())
        step = TURNS // config.headings
        weight = np.roll(np.exp(-((one.gaps[::step] / _AS_GOOD) ** 2)), own)
        offs.append(place[:, 0].copy())
        # a quarter turn from its own heading its edges change places
        sideways = (own + config.headings // 4 * np.array([1, 3])) % config.headings
        place[sideways, 4:7] = place[sideways, 4:7][:, ::-1]
        place[:, 0] = place[own, 0]
        points.append(made.points)
        sizes.append(made.box.size / unit)
        weights.append(weight / weight.sum())
        places.append(place)
        alike.append(one.gaps < SAME)
    looked, edges, good, wanted, angles = (
        torch.from_numpy(np.array(each, np.float32)) for each in (points, sizes, weights, places, offs)
    )
    same = torch.from_numpy(np.array(alike))
    return Batch(looked, edges, good, wanted, angles, same, draws.shape[list(rows)])


_work: Callable[[int], dict[str, np.ndarray]]
"""Of a forked process: the network need not be sent to it."""


def _inherit(work: Callable[[tuple[int, Shape]], dict[str, np.ndarray]], shapes: Sequence[Shape]) -> None:
    global _work
    _work = lambda number: work((number, shapes[number]))  # noqa: E731


def _inherited(number: int) -> dict[str, np.ndarray]:
    return _work(number)


def _drawn(
    numbered: tuple[int, Shape], prior: ShapePrior, each: int, config: SceneConfig, seed: int, cache: Path
) -> dict[str, np.ndarray]:
    """All draws of one shape; nothing where it has no surface."""
    number, shape = numbered
    path = cache / f"{number:05d}.safetensors"
    with suppress(SafetensorError, FileNotFoundError):
        return load_file(path)
    try:
        mesh = shape.in_prior(prior)
    except SolveError:
        return {}
    extents = mesh.extents / np.linalg.norm(mesh.extents) if shape.extents is None else shape.extents
    rng = np.random.default_rng([seed, number])
    seen = [draw_seen(mesh, extents, prior, config, rng) for _ in range(each)]
    rows = [_row(one, mesh, rng) for one in seen if one is not None]
    if not rows:
        return {}
    part = {key: np.stack([row[key] for row in rows]) for key in rows[0]}
    write_file(path, save(part), PriorError)
    return part


def _row(seen: SeenObject, mesh: trimesh.Trimesh, rng: Generator) -> dict[str, np.ndarray]:
    views = [view_cloud(view) for view in seen.views]
    surface, normal, free, eye = (np.zeros((VIEWS, n, 3), np.float16) for n in (_SURFACE, _SURFACE, _FREE, 1))
    for k, view in enumerate(views):
        some = _some(len(view.surface), _SURFACE, rng)
        surface[k], normal[k] = view.surface[some], view.normals[some]
        points = view.free if len(view.free) else view.surface
        free[k] = points[_some(len(points), _FREE, rng)]
        eye[k] = view.eye
    return {
        "surface": surface, "normal": normal, "free": free, "eye": eye[:, 0], "views": np.array(len(views)),
        "floor": np.array(np.nan if seen.floor is None else seen.floor), "T_world_object": seen.T_world_object,
        "log_scale": np.log(seen.scale), "gaps": turn_gaps(_scaled(mesh, seen.scale), _TURNS),
    }  # fmt: skip


def _some(there: int, count: int, rng: Generator) -> np.ndarray:
    """Which points are kept; some of them more than once where there are too few."""
    return rng.choice(there, count, replace=there < count)


def _scaled(mesh: trimesh.Trimesh, scale: Float[np.ndarray, "3"]) -> trimesh.Trimesh:
    return trimesh.Trimesh(mesh.vertices * scale, mesh.faces, process=False)
