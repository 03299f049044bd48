"""An object's marginal covariance, from the graph."""

from collections.abc import Iterable, Sequence

import gtsam
import numpy as np
from jaxtyping import Float

from factors.keys import readable_key
from factors.state import ObjectKeys
from objgraph.covariance.labelled import ObjectCovariance
from objgraph.diagnostics.null_space import TOLERANCE
from objgraph.diagnostics.undetermined import (
    check_linear,
    explanation,
    loose_directions,
    require_values,
    without_factors,
)
from objgraph.errors import SolveError
from objgraph.linear import hessian_diagonal


def marginals(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, keys: ObjectKeys) -> ObjectCovariance:
    """The object's joint marginal in `graph` at `values`.

    Raises:
        SolveError: the graph leaves something undetermined; the message names keys, directions and the missing priors.
    """
    return ObjectCovariance.of(joint_covariance(graph, values, list(keys), [keys]), "marginals")


def joint_covariance(
    graph: gtsam.NonlinearFactorGraph,
    values: gtsam.Values,
    keys: Sequence[int],
    objects: Iterable[ObjectKeys] = (),
) -> Float[np.ndarray, "d d"]:
    """Joint marginal covariance of `keys`, in their order.

    `objects` are the keys of objects that have none of the default letters, for messages.

    Raises:
        SolveError: it is not determined; the message names keys, directions and the missing priors.
    """
    require_values(graph, values)
    known = set(graph.keyVector())
    lonely = [key for key in keys if key not in known]
    for key in lonely:
        if not values.exists(key):
            raise SolveError(f"{readable_key(key)} has no covariance: it is not in the values")
    if lonely:
        raise SolveError(explanation(without_factors(lonely, values, objects)))
    linear = graph.linearize(values)
    try:
        joint = gtsam.Marginals(linear, values).jointMarginalCovariance(gtsam.KeyVector(keys))
    except RuntimeError as error:
        raise SolveError(explanation(loose_directions(linear, values, objects, at_least=1))) from error
    matrix = np.block([[joint.at(a, b) for b in keys] for a in keys])
    if _is_rounding(matrix, linear, keys):
        # Cholesky went through by chance
        check_linear(linear, values, objects)
    return 0.5 * (matrix + matrix.T)


def _is_rounding(
    matrix: Float[np.ndarray, "d d"], linear: gtsam.GaussianFactorGraph, keys: Sequence[int]
) -> bool:
    """Whether variances exceed what the factors say of the same unknowns by as much as rounding would."""
    near = gtsam.GaussianFactorGraph()
    for i in range(linear.size()):
        if linear.exists(i) and not set(keys).isdisjoint(linear.at(i).keys()):
            near.push_back(linear.at(i))
    diagonal = hessian_diagonal(near)
    information = np.concatenate([diagonal[key] for key in keys])
    spread = np.diag(matrix)
    return not (spread > 0).all() or bool((spread * information).max() > 1e-2 / TOLERANCE**2)
