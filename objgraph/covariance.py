"""Labelled covariances of an object, from the graph, and what they mean on its surface."""

from collections.abc import Sequence
from dataclasses import dataclass

import gtsam
import numpy as np
import torch
from jaxtyping import Float
from scipy.sparse import csc_matrix, diags, eye
from scipy.sparse.linalg import splu

from factors.sdf import metres_per_unit, propagated_variance, query_points, sdf_jacobian
from factors.sdf_decoder import SdfDecoder
from factors.state import RIGID_DOF, ObjectKeys, ObjectState
from objgraph.errors import SolveError

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
        SolveError: the graph leaves something undetermined; the message names the key and what is missing.
    """
    return ObjectCovariance.of(joint_covariance(graph, values, list(keys)), "marginals")


def joint_covariance(
    graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, keys: Sequence[int]
) -> Float[np.ndarray, "d d"]:
    """Joint marginal covariance of `keys`, in their order; raises SolveError where it is not determined."""
    for key in keys:
        if graph.keys().count(key) == 0:
            raise SolveError(_undetermined(gtsam.DefaultKeyFormatter(key)))
    try:
        joint = gtsam.Marginals(graph, values).jointMarginalCovariance(gtsam.KeyVector(keys))
    except RuntimeError as error:
        key = _loosest_key(graph.linearize(values))
        raise SolveError(_undetermined(gtsam.DefaultKeyFormatter(key))) from error
    matrix = np.block([[joint.at(a, b) for b in keys] for a in keys])
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


def _loosest_key(linear: gtsam.GaussianFactorGraph) -> int:
    """The variable that moves most in the directions that no factor sees.

    GTSAM names the variable at which its elimination stops, which depends on the ordering.
    """
    keys = sorted(linear.keyVector())
    dims = [linear.gradientAtZero().at(key).size for key in keys]
    row, column, value = linear.sparseJacobian_()  # counted from 1; the last column is the right-hand side
    entries = value, (row.astype(int) - 1, column.astype(int) - 1)
    J = csc_matrix(entries, shape=(int(row.max()), sum(dims) + 1))[:, : sum(dims)]
    norm = np.sqrt(np.asarray(J.multiply(J).sum(axis=0)).ravel())
    J = J @ diags(1.0 / np.where(norm > 0, norm, 1.0))
    # the inverse of a barely regular Hessian throws whatever it is given into the unseen directions
    probe = np.random.default_rng(0).normal(size=(sum(dims), 8))
    unseen = splu((J.T @ J + 1e-10 * eye(sum(dims))).tocsc()).solve(probe)
    share = np.add.reduceat(np.square(unseen).sum(axis=1), np.cumsum([0, *dims[:-1]]))
    return keys[int(np.argmax(share))]


def _undetermined(name: str) -> str:
    missing = {"s": "a scale prior", "z": "a code prior", "o": "views of the object or a pose prior"}
    return (
        f"the graph does not determine {name}: it needs {missing.get(name[0], 'a prior')}, "
        "or more measurements of it"
    )
