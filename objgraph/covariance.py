"""Labelled covariances of an object, from the graph, and what they mean on its surface."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import gtsam
import numpy as np
import torch
from jaxtyping import Float

from factors.keys import readable_key
from factors.sdf import metres_per_unit, propagated_variance, query_points, sdf_jacobian
from factors.sdf_decoder import SdfDecoder
from factors.state import RIGID_DOF, ObjectKeys, ObjectState
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

RIGID_AXES = (
    *(f"rotation_{axis} [rad, object frame]" for axis in "xyz"),
    *(f"translation_{axis} [m, object frame]" for axis in "xyz"),
    *(f"log_scale_{axis} [1, object axis]" for axis in "xyz"),
)
"""GTSAM's Pose3 tangent in the body frame, then the log-scale."""


@dataclass(frozen=True)
class ObjectCovariance:
    """Joint covariance of pose, log-scale and code, with the meaning of every axis."""

    matrix: Float[np.ndarray, "9+l 9+l"]
    axes: tuple[str, ...]
    """One label a row: quantity, unit and frame."""
    source: str
    """Which estimate this is: "marginals" for the graph's, "adam" for the paper's."""

    @classmethod
    def of(cls, matrix: Float[np.ndarray, "9+l 9+l"], source: str) -> "ObjectCovariance":
        """A covariance over [rotation, translation, log-scale, code]."""
        axes = (*RIGID_AXES, *(f"code_{i} [1]" for i in range(len(matrix) - RIGID_DOF)))
        return cls(matrix, axes, source)

    @classmethod
    def diagonal(cls, variance: Float[np.ndarray, "9+l"], source: str) -> "ObjectCovariance":
        """Independent axes of these variances."""
        return cls.of(np.diag(variance), source)

    @property
    def rigid(self) -> Float[np.ndarray, "9 9"]:
        """Rotation, translation and log-scale."""
        return self.matrix[:RIGID_DOF, :RIGID_DOF]

    @property
    def code(self) -> Float[np.ndarray, "l l"]:
        return self.matrix[RIGID_DOF:, RIGID_DOF:]

    @property
    def sigma(self) -> Float[np.ndarray, "9+l"]:
        """Standard deviation of every axis."""
        return np.sqrt(np.diag(self.matrix))


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


def surface_sigma(
    decoder: SdfDecoder,
    state: ObjectState,
    covariance: ObjectCovariance,
    p_object: Float[np.ndarray, "n 3"],
) -> Float[np.ndarray, "n"]:
    """Standard deviation, metres, of the surface along its normal at canonical points on it."""
    query = query_points(decoder, state, gtsam.Pose3(), state.to_world(p_object))
    jet = decoder.linearize(query.p_object, query.code[None])
    metres = metres_per_unit(jet.d_point, state).double()
    jacobian = metres[:, None] * sdf_jacobian(query, jet, camera=False).double()
    return propagated_variance(jacobian, torch.as_tensor(covariance.matrix)).clamp_min(0).sqrt().numpy()


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
