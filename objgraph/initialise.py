"""First guesses of an object's pose and scale from its points, and the choice among them.

As in the paper, the prior's mean shape is matched to the cloud over headings about gravity. The match is the graph
itself on few points and rays: every guess is a small problem, all are solved together, and the cheapest are kept.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import cv2
import gtsam
import numpy as np
from jaxtyping import Float

from factors.depth import RaySampling
from factors.state import ObjectState
from objgraph.errors import InitialisationError
from objgraph.graph import GraphConfig, ObjectGraph
from objgraph.mesh import extract_mesh
from objgraph.prior.prior import ShapePrior
from objgraph.sampling import ObjectView
from objgraph.solve import LevenbergMarquardtConfig, Problem, SolverConfig, solve


@dataclass(frozen=True)
class InitialisationConfig:
    """Guesses, and how cheaply they are told apart."""

    headings: int = 8
    """Guesses, evenly spaced about gravity from the direction of the smallest box."""
    points: int = 150
    """Surface points of all views together for the first ranking."""
    rays: int = 150
    """Rays of all views together for the first ranking."""
    sampling: RaySampling = field(default_factory=lambda: RaySampling(coarse=12, cells=8))
    slope: float = 60.0
    """Occupancy slope while guesses are told apart, 1/metres."""
    inner: LevenbergMarquardtConfig = field(
        default_factory=lambda: LevenbergMarquardtConfig(iterations=4, relative_tolerance=1e-2)
    )
    """Each round of that."""
    shortlist: int = 4
    """Guesses that are left after the first round."""
    keep: int = 2
    """Guesses that go on to the full solution."""
    floor_reach: float = 0.8
    """An object whose lowest seen point is less than this above the floor stands on it, metres."""


@dataclass(frozen=True)
class GravityBox:
    """A box about an object's points, two faces level."""

    centre_world: Float[np.ndarray, "3"]
    size: Float[np.ndarray, "3"]
    """Along the object's x, y (up) and z axes."""
    R_world_object: Float[np.ndarray, "3 3"]


def gravity_box(
    points_world: Float[np.ndarray, "n 3"],
    up_world: Float[np.ndarray, "3"],
    heading: float,
    floor: float | None = None,
    floor_reach: float = 0.8,
) -> GravityBox:
    """The box at `heading` radians that holds the points between their 1st and 99th percentile on every axis.

    Heading 0 turns the object's x axis along an arbitrary but fixed level direction. Where the floor's height is
    known and near, the box stands on it.
    """
    R = _upright(up_world, heading)
    low, high = np.percentile(points_world @ R, [1, 99], axis=0)
    if floor is not None and low[1] - floor < floor_reach:
        low[1] = floor
    return GravityBox(R @ (0.5 * (low + high)), np.maximum(high - low, 0.05), R)


def smallest_heading(points_world: Float[np.ndarray, "n 3"], up_world: Float[np.ndarray, "3"]) -> float:
    """Heading at which the gravity box has the smallest footprint."""
    level = points_world @ _upright(up_world, 0.0)[:, [0, 2]]
    low, high = np.percentile(level, [1, 99], axis=0)
    inside = level[((level >= low) & (level <= high)).all(axis=1)]
    # minAreaRect turns from x towards z; a positive heading turns x towards -z
    return -np.radians(cv2.minAreaRect(inside.astype(np.float32))[2])


def guesses(
    prior: ShapePrior,
    views: Sequence[ObjectView],
    up_world: Float[np.ndarray, "3"],
    floor: float | None,
    config: InitialisationConfig,
) -> list[ObjectState]:
    """One state a heading: the mean shape, as high as the box and in its middle.

    Raises:
        InitialisationError: there are too few points to put a box about.
    """
    points = np.concatenate([view.points_world for view in views]) if views else np.zeros((0, 3))
    if len(points) < 10:
        raise InitialisationError(f"{len(points)} points are too few to place an object; add views of it")
    extents = mean_extents(prior)
    start = smallest_heading(points, up_world)
    states = []
    for heading in start + np.arange(config.headings) * 2 * np.pi / config.headings:
        box = gravity_box(points, up_world, heading, floor, config.floor_reach)
        ratio = np.log(box.size / extents)
        size = np.clip(_size(ratio, floor is not None), *_log_range(prior))
        log_scale = size + np.clip(ratio - size, -0.3, 0.3) * 0.5
        T_world_object = gtsam.Pose3(gtsam.Rot3(box.R_world_object), box.centre_world)
        states.append(ObjectState(T_world_object, log_scale, np.array(prior.code_mean, dtype=float)))
    return states


def mean_extents(prior: ShapePrior) -> Float[np.ndarray, "3"]:
    """Canonical extents of the prior's mean shape."""
    return extract_mesh(prior.decoder, prior.code_mean, resolution=32).extents


def rank(
    prior: ShapePrior,
    views: Sequence[ObjectView],
    states: Sequence[ObjectState],
    up_world: Float[np.ndarray, "3"],
    config: InitialisationConfig,
    graph_config: GraphConfig,
) -> tuple[list[ObjectState], list[Problem]]:
    """The best of `states` after a cheap solution of each, cheapest first, and the problems that were solved.

    Raises:
        InitialisationError: every guess failed; the message says why the first did.
    """
    share = max(1, len(views))
    thin = [
        view.thinned(config.points // share, config.rays // share, seed=i) for i, view in enumerate(views)
    ]
    settings = replace(graph_config, sampling=config.sampling)
    graphs = [single_object_graph(prior, state, thin, up_world, settings) for state in states]
    problems = [graph.problems()[0] for graph in graphs]
    solve(problems, SolverConfig((config.slope,), 1, inner=config.inner))
    shortlist = sorted(_solved(problems), key=lambda i: problems[i].cost)[: config.shortlist]
    solve([problems[i] for i in shortlist], SolverConfig((config.slope,), 2, inner=config.inner))
    shortlist = [i for i in shortlist if problems[i].failure is None]
    if not shortlist:
        raise InitialisationError(f"none of {len(states)} guesses could be solved: {problems[0].failure}")
    best = []
    for i in sorted(shortlist, key=lambda i: problems[i].cost):
        state = ObjectState.from_values(problems[i].values, graphs[i].objects[0].keys)
        if not any(_same_heading(state, other) for other in best):
            best.append(state)
    return best[: config.keep], problems


def _solved(problems: Sequence[Problem]) -> list[int]:
    return [i for i, problem in enumerate(problems) if problem.failure is None]


def single_object_graph(
    prior: ShapePrior,
    state: ObjectState,
    views: Sequence[ObjectView],
    up_world: Float[np.ndarray, "3"] | None,
    config: GraphConfig,
) -> ObjectGraph:
    """A graph of one object and its views at fixed cameras."""
    objects = ObjectGraph(gtsam.NonlinearFactorGraph(), gtsam.Values(), config)
    handle = objects.add_object(prior, state, up_world=up_world)
    for view in views:
        objects.observe(handle, view)
    return objects


def _upright(up_world: Float[np.ndarray, "3"], heading: float) -> Float[np.ndarray, "3 3"]:
    """Object axes in the world: y up, x at `heading` about it."""
    up = np.asarray(up_world, float) / np.linalg.norm(up_world)
    helper = np.eye(3)[np.argmin(np.abs(up))]
    x0 = np.cross(up, helper)
    x0 /= np.linalg.norm(x0)
    z0 = np.cross(x0, up)
    x = np.cos(heading) * x0 - np.sin(heading) * z0
    return np.stack([x, up, np.cross(x, up)], axis=1)


def _size(log_ratio: Float[np.ndarray, "3"], stands: bool) -> float:
    """Common log-scale: the height where the floor is known (it is then seen whole), else all extents."""
    return float(log_ratio[1] if stands else log_ratio.mean())


def _log_range(prior: ShapePrior) -> tuple[float, float]:
    reach = 2.5 * prior.size_log_sigma
    return np.log(prior.size_mean) - reach, np.log(prior.size_mean) + reach


def _same_heading(a: ObjectState, b: ObjectState, angle: float = 0.25) -> bool:
    between = a.T_world_object.rotation().between(b.T_world_object.rotation())
    return bool(np.linalg.norm(gtsam.Rot3.Logmap(between)) < angle)
