"""First guesses of an object's pose, scale and code from its views, and the choice among them.

A prior with a first guess proposes them. Of others, as in the paper, the mean shape is matched to the cloud over headings
about gravity. The match is the graph itself on few points and rays: every guess is a small problem, all are solved
together, and the cheapest are kept.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import gtsam
import numpy as np
import torch
from jaxtyping import Float

from factors import checks
from factors.base import SLOPES
from factors.depth import RaySampling
from factors.state import ObjectState
from objgraph.errors import ConfigError, InitialisationError, ObservationError
from objgraph.geometry.frames import transformed
from objgraph.graph.builder import DetectedBox, ObjectBuilder
from objgraph.graph.proposals import proposals
from objgraph.graph.single_object import SingleObject
from objgraph.graph.solve import LevenbergMarquardtConfig, Problem, SolverConfig, solve
from objgraph.observation.gravity_box import gravity_box, smallest_heading
from objgraph.observation.sampling import ObjectView, thinned
from objgraph.priors.shape_prior import ShapePrior
from objgraph.work import torch_threads


@dataclass(frozen=True)
class FirstStates:
    """Where an object may be by its views."""

    states: tuple[ObjectState, ...]
    """The likeliest first."""
    chances: tuple[float, ...] = ()
    """How likely the prior's first guess holds each of them to be; empty where it has none."""
    tried: tuple[SingleObject, ...] = ()
    """Problems that were solved to find out."""


@dataclass(frozen=True)
class InitialisationConfig:
    """Guesses, and how cheaply they are told apart; all but the first are for priors without a first guess."""

    least_chance: float = 0.03
    """Of the headings that a prior's first guess proposes those are solved that are at least as likely."""
    headings: int = 8
    """Evenly spaced about gravity, from the direction of the smallest box."""
    guesses: int = 10
    """Of all headings and starting shapes, how many are solved on few points."""
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

    def __post_init__(self) -> None:
        """Raises ConfigError where a number is not one of its kind."""
        few = checks.Range(1, 1000)
        checks.settings(
            self, ConfigError, least_chance=checks.Range(0, 1), headings=few, guesses=few, points=checks.Range(1),
            rays=checks.Range(1), slope=SLOPES, shortlist=few, keep=few,
        )  # fmt: skip


@torch_threads(1)  # what is found then depends on no number of them
def first_states(
    prior: ShapePrior,
    views: Sequence[ObjectView],
    builder: ObjectBuilder,
    config: InitialisationConfig | None = None,
    box: DetectedBox | None = None,
) -> FirstStates:
    """Where an object may be by its views at known cameras; of a prior without a first guess, by a detector's box too.

    Raises:
        ObservationError: it is not known which way is up.
        InitialisationError: there are too few points, or no guess can be solved.
    """
    config = checks.settings_or_default(config, InitialisationConfig, ConfigError)
    checks.instance("prior", prior, ShapePrior, InitialisationError)
    checks.instance("builder", builder, ObjectBuilder, InitialisationError)
    if builder.up_world is None:
        raise ObservationError("to place an object by its views, say which way is up (up_world=...)")
    if prior.guess is not None:
        first, *others = proposals(prior, views, builder.up_world, builder.floor)
        # one that the guess holds for impossible has no chance, however little is asked for
        likely = [
            first,
            *(each for each in others if each.probability >= config.least_chance and each.probability > 0),
        ]
        return FirstStates(tuple(each.state for each in likely), tuple(each.probability for each in likely))
    states = guesses(prior, views, builder.up_world, builder.floor, config)
    best, tried = rank(prior, views, states, builder, config, box)
    return FirstStates(tuple(best), tried=tuple(tried))


def guesses(
    prior: ShapePrior,
    views: Sequence[ObjectView],
    up_world: Float[np.ndarray, "3"],
    floor: float | None,
    config: InitialisationConfig,
) -> list[ObjectState]:
    """The most promising of all headings and starting shapes, each as high as the points' box and in its middle.

    Raises:
        InitialisationError: there are too few points to put a box about.
    """
    points = np.concatenate([view.points_world for view in views]) if views else np.zeros((0, 3))
    points = points[np.isfinite(points).all(axis=1)]
    if len(points) < 10:
        raise InitialisationError(f"{len(points)} points are too few to place an object; add views of it")
    start = smallest_heading(points, up_world)
    headings = start + np.arange(config.headings) * 2 * np.pi / config.headings
    boxes = [gravity_box(points, up_world, angle, floor, config.floor_reach) for angle in headings]
    if prior.is_fallback:
        # it has no front to be found: its x axis is along the longer level side
        boxes = [box for box in boxes if box.size[0] >= box.size[2]] or boxes
    states = []
    for box in boxes:
        T_world_object = gtsam.Pose3(gtsam.Rot3(box.R_world_object), box.centre_world)
        for code, extents in zip(prior.starts, prior.start_extents, strict=True):
            if np.isfinite(extents).all():
                log_scale = _log_scale(np.log(box.size / extents), floor is not None, prior)
                states.append(ObjectState(T_world_object, log_scale, np.array(code, dtype=float)))
    if not states:
        raise InitialisationError(
            f"no starting shape of the {prior.category} prior has a surface; retrain it"
        )
    off = misfit(prior, states, points, free_points(views))
    return [states[i] for i in np.argsort(off, kind="stable")[: config.guesses]]


def _log_scale(log_ratio: Float[np.ndarray, "3"], stands: bool, prior: ShapePrior) -> Float[np.ndarray, "3"]:
    """Log-scale from the box over the shape: its height where the floor is known, its sides half as far.

    The sides of a shape that scales alone can stretch are the box's own.
    """
    # on a known floor the height is seen whole, the other sides may be cut off
    size = float(log_ratio[1] if stands else log_ratio.mean())
    reach = 2.5 * prior.size_log_sigma
    size = np.clip(size, np.log(prior.size_mean) - reach, np.log(prior.size_mean) + reach)
    anisotropy = prior.anisotropy_sigma
    share, limit = (0.5, 0.3) if anisotropy is None else (1.0, 2.5 * anisotropy)
    return size + share * np.clip(log_ratio - size, -limit, limit)


def free_points(views: Sequence[ObjectView]) -> Float[np.ndarray, "m 3"]:
    """World points that are seen to be empty: on the free rays, as deep as the object next to them."""
    points = []
    for view in views:
        rays = view.rays
        free = ~rays.hit & (rays.end > rays.depth)
        p_camera = rays.directions_camera[free] * rays.depth[free, None]
        points.append(transformed(view.T_world_camera.matrix(), p_camera))
    return np.concatenate(points)


def misfit(
    prior: ShapePrior,
    states: Sequence[ObjectState],
    p_surface: Float[np.ndarray, "n 3"],
    p_free: Float[np.ndarray, "m 3"],
    count: int = 120,
    limit: float = 0.15,
) -> Float[np.ndarray, "s"]:
    """Mean distance of surface points from each state's surface and of free points into it, metres, cut off."""
    rng = np.random.default_rng(0)
    surface = p_surface[rng.permutation(len(p_surface))[:count]]
    free = p_free[rng.permutation(len(p_free))[:count]]
    points = [np.concatenate([state.to_object(surface), state.to_object(free)]) for state in states]
    like = prior.decoder.like
    codes = torch.as_tensor(np.stack([state.code for state in states])).to(like)
    owner = torch.arange(len(states)).repeat_interleave(len(points[0])).to(like.device)
    with torch.no_grad():
        sdf = prior.decoder(torch.as_tensor(np.concatenate(points)).to(like), codes, owner)
    metres = np.exp([state.log_scale.mean() for state in states])[:, None]
    distance = sdf.cpu().double().numpy().reshape(len(states), -1) * metres
    on, off = np.split(distance, [len(surface)], axis=1)
    missed = np.minimum(np.abs(on), limit).mean(axis=1)
    inside = np.clip(-off, 0.0, limit).mean(axis=1) if off.size else 0.0
    return missed + inside


def rank(
    prior: ShapePrior,
    views: Sequence[ObjectView],
    states: Sequence[ObjectState],
    builder: ObjectBuilder,
    config: InitialisationConfig,
    box: DetectedBox | None = None,
) -> tuple[list[ObjectState], list[SingleObject]]:
    """The best of `states` after a cheap solution of each, cheapest first, and the problems that were solved.

    Of several that came to the same heading only the cheapest is kept.

    Raises:
        InitialisationError: every guess failed; the message says why the first did.
    """
    thin = thinned(views, config.points, config.rays)
    # starting shapes fill their box: a few steps from them need not be told
    cheap = replace(builder, config=replace(builder.config, sampling=config.sampling, sides=None))
    problems = [cheap.alone(prior, state, thin, box) for state in states]
    solve(problems, SolverConfig((config.slope,), 1, inner=config.inner))
    shortlist = sorted(_solved(problems), key=lambda i: problems[i].cost)[: config.shortlist]
    solve([problems[i] for i in shortlist], SolverConfig((config.slope,), 2, inner=config.inner))
    shortlist = [i for i in shortlist if problems[i].failure is None]
    if not shortlist:
        # the first guess itself may have been left out before any that went on failed
        failure = next(problem.failure for problem in problems if problem.failure is not None)
        raise InitialisationError(f"none of {len(states)} guesses could be solved: {failure}")
    best = []
    for i in sorted(shortlist, key=lambda i: problems[i].cost):
        state = problems[i].state
        if not any(_same_heading(state, other) for other in best):
            best.append(state)
    return best[: config.keep], problems


def _solved(problems: Sequence[Problem]) -> list[int]:
    return [i for i, problem in enumerate(problems) if problem.failure is None]


def _same_heading(a: ObjectState, b: ObjectState, angle: float = 0.25) -> bool:
    between = a.T_world_object.rotation().between(b.T_world_object.rotation())
    return bool(np.linalg.norm(gtsam.Rot3.Logmap(between)) < angle)
