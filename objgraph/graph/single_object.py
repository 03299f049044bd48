"""One object in a graph of its own, seen from cameras that are known, exactly or nearly."""

from dataclasses import dataclass, field, replace

import gtsam
import numpy as np
from jaxtyping import Float

from factors.state import ObjectKeys, ObjectState
from objgraph.covariance.heading_ring import HEADINGS, with_other_headings
from objgraph.covariance.labelled import ObjectCovariance
from objgraph.covariance.posterior import marginals
from objgraph.errors import ObjectGraphError
from objgraph.graph.solve import Problem

ALONE = ObjectKeys.numbered(0)
"""Its keys."""


@dataclass
class SingleObject(Problem):
    """An object's own problem, and where its estimate began."""

    start: gtsam.Values = field(default_factory=gtsam.Values)

    @property
    def state(self) -> ObjectState:
        """The current estimate."""
        return ObjectState.from_values(self.values, ALONE)

    def marginals(self) -> ObjectCovariance:
        """The graph's joint covariance of pose, log-scale and code; raises SolveError where undetermined."""
        return marginals(self.graph, self.values, ALONE)

    def covariance(self, slope: float) -> ObjectCovariance:
        """The graph's marginals, wider where other headings are about as likely; raises SolveError where undetermined.

        `slope` is the occupancy's, at which the estimate was solved.
        """
        return with_other_headings(self.marginals(), lambda: self.heading_costs(slope))

    def heading_costs(self, slope: float) -> Float[np.ndarray, "24"]:
        """Costs of the object turned about its own up axis, the estimate's first, all else held; NaN where it has none."""
        place, costs = self.values.atPose3(ALONE.pose), []
        for angle in 2 * np.pi * np.arange(HEADINGS) / HEADINGS:
            turned = gtsam.Values(self.values)
            turned.update(ALONE.pose, place.compose(gtsam.Pose3(gtsam.Rot3.Ry(angle), np.zeros(3))))
            try:
                costs.append(replace(self, values=turned).refreshed_cost(slope))
            except (
                ObjectGraphError,
                RuntimeError,
            ):  # the decoder's failure there says nothing of the estimate
                costs.append(np.nan)
        self.refresh(slope)
        return np.array(costs)
