"""One object in a graph of its own, seen from cameras that are known."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import gtsam
import numpy as np
from jaxtyping import Float

from factors.base import ObservationFactor
from factors.state import ObjectKeys, ObjectState
from objgraph.covariance.heading_ring import HEADINGS, with_other_headings
from objgraph.covariance.labelled import ObjectCovariance
from objgraph.covariance.posterior import marginals
from objgraph.errors import ObjectGraphError
from objgraph.graph.builder import (
    DetectedBox,
    GraphConfig,
    box_factor,
    detection_priors,
    floor_factor,
    state_priors,
    view_factors,
)
from objgraph.graph.solve import Problem
from objgraph.observation.sampling import ObjectView
from objgraph.priors.shape_prior import ShapePrior

_KEYS = ObjectKeys.numbered(0)


@dataclass
class SingleObject:
    """An object's own graph, where its estimate began, and the problem whose values are where it stands."""

    start: gtsam.Values
    problem: Problem

    @property
    def state(self) -> ObjectState:
        """The current estimate."""
        return ObjectState.from_values(self.problem.values, _KEYS)

    def cost_of_start(self, slope: float) -> float:
        """What the start costs with samples and weights of its own, at an occupancy slope."""
        return replace(self.problem, values=self.start).refreshed_cost(slope)

    def marginals(self) -> ObjectCovariance:
        """The graph's joint covariance of pose, log-scale and code; raises SolveError where undetermined."""
        return marginals(self.problem.graph, self.problem.values, _KEYS)

    def covariance(self, slope: float) -> ObjectCovariance:
        """The graph's marginals, wider where other headings are about as likely; raises SolveError where undetermined.

        `slope` is the occupancy's, at which the estimate was solved.
        """
        return with_other_headings(self.marginals(), lambda: self.heading_costs(slope))

    def heading_costs(self, slope: float) -> Float[np.ndarray, "24"]:
        """Costs of the object turned about its own up axis, the estimate's first, all else held; NaN where it has none."""
        place, costs = self.problem.values.atPose3(_KEYS.pose), []
        for angle in 2 * np.pi * np.arange(HEADINGS) / HEADINGS:
            turned = gtsam.Values(self.problem.values)
            turned.update(_KEYS.pose, place.compose(gtsam.Pose3(gtsam.Rot3.Ry(angle), np.zeros(3))))
            try:
                costs.append(replace(self.problem, values=turned).refreshed_cost(slope))
            except (
                ObjectGraphError,
                RuntimeError,
            ):  # the decoder's failure there says nothing of the estimate
                costs.append(np.nan)
        self.problem.refresh(slope)
        return np.array(costs)


def single_object(
    prior: ShapePrior,
    state: ObjectState,
    views: Sequence[ObjectView],
    up_world: Float[np.ndarray, "3"] | None,
    floor: float | None,
    config: GraphConfig,
    box: DetectedBox | None = None,
) -> SingleObject:
    """One object at `state`, its views, the floor where its height along `up_world` is known, and a detector's box.

    Raises:
        FactorError: the state or a view cannot be used.
    """
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    state.insert(values, _KEYS)
    for factor in state_priors(prior, _KEYS, config, up_world):
        graph.push_back(factor)
    for factor in [] if box is None else detection_priors(prior, _KEYS, box):
        graph.push_back(factor)
    factors: list[ObservationFactor] = [
        factor for view in views for factor in view_factors(prior, _KEYS, view, view.T_world_camera, config)
    ]
    factors += box_factor(prior, _KEYS, config)
    if floor is not None and up_world is not None:
        factors.append(floor_factor(prior, _KEYS, up_world, floor, config))
    for factor in factors:
        graph.push_back(factor.gtsam_factor())
    return SingleObject(values, Problem(prior.category, graph, values, factors))
