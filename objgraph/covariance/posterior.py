"""Marginal covariances, from the graph."""

from collections.abc import Iterable, Sequence

import gtsam
import numpy as np
from jaxtyping import Float

from factors import checks
from factors.keys import readable_key
from factors.state import ObjectKeys
from objgraph.covariance.joint import joint_covariance
from objgraph.covariance.labelled import ObjectCovariance
from objgraph.diagnostics.linear import hessian_diagonal
from objgraph.diagnostics.null_space import TOLERANCE
from objgraph.diagnostics.undetermined import (
    check_finite,
    check_linear,
    explanation,
    linearised,
    loose_directions,
    without_factors,
)
from objgraph.errors import SolveError


def marginals(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, keys: ObjectKeys) -> ObjectCovariance:
    """The object's joint marginal in `graph` at `values`; of several objects, ask a `Posterior`.

    Raises:
        SolveError: the graph leaves something undetermined; the message names keys, directions and the missing priors.
    """
    return Posterior(graph, values, [keys]).marginals(keys)


class Posterior:
    """The Gaussian that a graph is at `values`, as GTSAM's Bayes tree: covariances of any variables in milliseconds.

    It is of the graph and the values as they were: what changes afterwards is not in it.
    """

    def __init__(
        self,
        graph: gtsam.NonlinearFactorGraph,
        values: gtsam.Values,
        objects: Iterable[ObjectKeys] = (),
    ) -> None:
        """`objects` are the keys of objects that have none of the default letters, for messages.

        Raises:
            SolveError: a variable has no value, a value or a factor is not finite, or the graph leaves something
                undetermined; the message names keys, directions and the missing priors.
        """
        self._linear = linearised(graph, values)
        check_finite(self._linear)
        self._values, self._objects = gtsam.Values(values), tuple(objects)
        self._known = set(graph.keyVector())
        self._diagonal: dict[int, np.ndarray] | None = None
        # ISAM2, not Marginals, which eliminates anew for every query of more than two variables
        self._tree = gtsam.ISAM2(gtsam.ISAM2Params())
        quadratics = gtsam.NonlinearFactorGraph()
        for i in range(self._linear.size()):
            if self._linear.exists(i):
                factor = self._linear.at(i)
                own = values.extract(gtsam.KeyVector(list(factor.keys())))
                quadratics.push_back(gtsam.LinearContainerFactor(factor, own))
        try:
            self._tree.update(quadratics, values.extract(gtsam.KeyVector(list(self._known))))
        except RuntimeError as error:
            raise self._undetermined() from error

    def joint_covariance(self, keys: Sequence[int]) -> Float[np.ndarray, "d d"]:
        """Joint marginal covariance of `keys`, in their order; of GTSAM's tangents, in the body frame of a `Pose3`.

        Raises:
            SolveError: there is no key, or one is none, is not in the values, has no factor, or is not determined; the
                message names it.
        """
        keys = checks.keys("keys", keys, SolveError)
        if not keys:
            raise SolveError("keys is empty: name the variables whose covariance is asked for")
        if twice := [key for key in keys if keys.count(key) > 1]:
            raise SolveError(f"{readable_key(twice[0])} is asked for twice; name each variable once")
        lonely = [key for key in keys if key not in self._known]
        for key in lonely:
            if not self._values.exists(key):
                raise SolveError(f"{readable_key(key)} has no covariance: it is not in the values")
        if lonely:
            raise SolveError(explanation(without_factors(lonely, self._values, self._objects)))
        try:
            matrix = joint_covariance(self._tree, keys)
        except RuntimeError as error:
            raise self._undetermined() from error
        if self._is_rounding(matrix, keys):
            # Cholesky went through by chance
            check_linear(self._linear, self._values, self._objects)
        return 0.5 * (matrix + matrix.T)

    def marginals(self, keys: ObjectKeys) -> ObjectCovariance:
        """An object's joint covariance of pose, log-scale and code; raises SolveError as `joint_covariance` does."""
        return ObjectCovariance.of(self.joint_covariance([*keys]), "marginals")

    def _undetermined(self) -> SolveError:
        return SolveError(
            explanation(loose_directions(self._linear, self._values, self._objects, at_least=1))
        )

    def _is_rounding(self, matrix: Float[np.ndarray, "d d"], keys: Sequence[int]) -> bool:
        """Whether variances exceed what the factors say of the same unknowns by as much as rounding would."""
        if self._diagonal is None:
            self._diagonal = hessian_diagonal(self._linear)
        information = np.concatenate([self._diagonal[key] for key in keys])
        spread = np.diag(matrix)
        return not (spread > 0).all() or bool((spread * information).max() > 1e-2 / TOLERANCE**2)
