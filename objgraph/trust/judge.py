"""The verdict on an object, and its box so that sets hold as many as they say: of any estimate, and of objects in a graph."""

from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np
from jaxtyping import Float

from factors import checks
from factors.state import ObjectState
from objgraph.covariance.box import BoxPose, box_pose
from objgraph.covariance.heading_modes import HeadingModes
from objgraph.covariance.heading_ring import HEADINGS, with_other_headings
from objgraph.covariance.labelled import ObjectCovariance
from objgraph.errors import CovarianceError, InitialisationError, ObjectGraphError
from objgraph.estimate.task import Estimate, EstimationTask
from objgraph.graph.builder import ObjectBuilder
from objgraph.graph.headings import SAMPLES
from objgraph.graph.initialise import FirstStates, first_states
from objgraph.graph.solve import SolverConfig
from objgraph.observation.sampling import ObjectView, thinned
from objgraph.priors.mesh import extract_mesh
from objgraph.priors.shape_prior import ShapePrior
from objgraph.trust.calibration import Calibration, shipped_calibration
from objgraph.trust.evidence import evidence_of
from objgraph.trust.verdict import Trust


@dataclass(frozen=True)
class Judgement:
    """How far an object is to be trusted."""

    trust: Trust
    box: BoxPose
    """Its covariance is calibrated, on estimates as `map_scan` makes them (how far it holds: docs/guides/covariances.md), and has the second
    moment of the other headings that it may have."""


class Handle(Protocol):
    """What a graph calls an object."""

    name: str
    prior: ShapePrior
    other_headings: HeadingModes | None


class Objects(Protocol):
    """A graph that holds objects: `ObjectGraph`, `IncrementalObjectGraph`, `ObjectFrontEnd`."""

    @property
    def builder(self) -> ObjectBuilder: ...

    def state(self, _: Any, /) -> ObjectState: ...

    def marginals(self, _: Any, /) -> ObjectCovariance: ...

    def views(self, _: Any, /) -> list[ObjectView]: ...


def judge(objects: Objects, handle: Handle, calibration: Calibration | None = None) -> Judgement | None:
    """How far an object of a graph is to be trusted as it stands there now; None where the calibration knows nothing of such ones.

    `objects` is the graph and `handle` what it calls the object; by default the shipped calibration is asked, which is of objects
    that `map_scan` placed from one to three views. How likely other headings are is what the map says of it or, where it does not,
    the prior's first guess by the object's views as their cameras stand now.

    Raises:
        ObservationError: the graph does not know which way is up.
        InitialisationError: its views show too few points, or it has none.
        CovarianceError: the calibration is none.
        SolveError: the graph leaves the object undetermined, or its code has no surface.
    """
    known = shipped_calibration() if calibration is None else calibration
    checks.instance("calibration", known, Calibration, CovarianceError)
    prior = handle.prior
    if known.of(prior.category, prior.digest) is None:
        return None
    task, estimate = estimate_in(objects, handle)
    state = estimate.state
    vertices = np.asarray(extract_mesh(prior.decoder, state.code).vertices)
    return judge_estimate(task, estimate, state.to_world(vertices), known)


def estimate_in(objects: Objects, handle: Handle) -> tuple[EstimationTask, Estimate]:
    """An object of a graph as an estimate of its own, without costs, and what it is one of; raises as `judge` does."""
    prior, state, views, builder = (
        handle.prior, objects.state(handle), objects.views(handle), objects.builder
    )  # fmt: skip
    if not views:
        raise InitialisationError(
            f"{handle.name} has no views to be judged by: observe it, or with a lag judge it before they are past that"
        )
    first = first_states(prior, views, builder)
    known = handle.other_headings  # as of where the object was when they were found
    turns = _other_headings(state, first) if known is None else known.carried(state)
    task = EstimationTask(
        handle.name, prior, first.states, tuple(views), builder.up_world, builder.floor, chances=first.chances
    )
    return task, Estimate.of_graph(state, covariance_in(objects, handle), turns)


def covariance_in(objects: Objects, handle: Handle) -> ObjectCovariance:
    """The graph's marginals of an object, wider where its views leave other headings about as likely, as a map's are.

    Raises:
        SolveError: the graph leaves the object undetermined.
    """

    def costs() -> Float[np.ndarray, "24"]:
        some = thinned(objects.views(handle), SAMPLES, SAMPLES)
        try:
            alone = objects.builder.alone(handle.prior, objects.state(handle), some)
        except ObjectGraphError:  # it leans too far to have another heading
            return np.where(np.arange(HEADINGS) > 0, np.inf, 0.0)
        return alone.heading_costs(SolverConfig().slopes[-1])

    return with_other_headings(objects.marginals(handle), costs)


def judge_estimate(
    task: EstimationTask,
    estimate: Estimate,
    vertices_world: Float[np.ndarray, "v 3"],
    calibration: Calibration,
) -> Judgement | None:
    """The same of an estimate of a task, whose surface has these vertices; None also where it has no marginals."""
    prior, state, covariance = task.prior, estimate.state, estimate.covariance
    known = calibration.of(prior.category, prior.digest)
    if known is None or covariance is None or covariance.source != "marginals":
        return None
    evidence, seen_sides = evidence_of(task, estimate, vertices_world)
    raw = box_pose(prior, state, covariance, state.to_object(vertices_world))
    box = known.box(evidence, raw, seen_sides)
    if estimate.turns is not None:
        moment = estimate.turns.second_moment(box.extents)
        box = replace(box, covariance=replace(box.covariance, matrix=box.covariance.matrix + moment))
    return Judgement(known.trust(evidence, calibration.digest), box)


def _other_headings(state: ObjectState, first: FirstStates) -> HeadingModes | None:
    """How likely the object stands as it does, or turned, by a first guess's probabilities; None where there is no guess."""
    if not first.chances:
        return None
    unlikely = np.append(np.inf, -np.log(first.chances))  # the state itself has what stands like it
    return HeadingModes.of_states([state, *first.states], unlikely, 0, temperature=1.0)
