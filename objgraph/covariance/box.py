"""An object's box as its 9-DoF pose, and how well it is known: scale and code share the size, a box has it whole."""

from dataclasses import dataclass, replace

import gtsam
import numpy as np
import torch
from jaxtyping import Float

from factors import checks
from factors.checks import PLACES
from factors.sdf_decoder import SdfDecoder
from factors.state import RIGID_DOF, ObjectState
from objgraph.covariance.heading_modes import HeadingModes
from objgraph.covariance.labelled import LabelledCovariance, ObjectCovariance, of_one_object
from objgraph.errors import CovarianceError, SolveError
from objgraph.priors.mesh import extract_mesh
from objgraph.priors.shape_prior import ShapePrior

_OUTERMOST = 0.01
"""Share of an extent within which a vertex belongs to the box's side."""
_FACING = 0.9
"""Cosine between the surface's normal and the side's above which it tells how the side moves."""

BOX_AXES = (
    *(f"rotation_{axis} [rad, object frame]" for axis in "xyz"),
    *(f"centre_{axis} [m, object frame]" for axis in "xyz"),
    *(f"log_extent_{axis} [1, object axis]" for axis in "xyz"),
)
"""GTSAM's Pose3 tangent of the box in its own frame, then the logarithms of its metric extents."""


@dataclass(frozen=True)
class BoxPose:
    """The oriented bounding box of an object's surface, along the object's axes."""

    T_world_box: gtsam.Pose3
    """Origin in the box's centre, axes the object's."""
    extents: Float[np.ndarray, "3"]
    """Edges, metres."""
    covariance: LabelledCovariance
    """Over `BOX_AXES`."""


def box_pose(
    prior: ShapePrior,
    state: ObjectState,
    covariance: ObjectCovariance,
    p_object: Float[np.ndarray, "v 3"] | None = None,
    turns: HeadingModes | None = None,
) -> BoxPose:
    """The object's box, with the covariance that `covariance` gives it: too small for real objects, see `objgraph.trust`.

    Every training shape of a prior with a `box` fills that box, and the graph holds codes to it: scale times the box are
    then the extents, nearer to the true ones than those of the mesh, which are drawn short (docs/decisions/2026-11-covariances.md). Of any
    other prior it is the box about `p_object`, the canonical vertices of the object's mesh, which are made where they
    are not given.
    `turns` widen the covariance by the other headings that the object may have: to the second moment of all about this one.

    Raises:
        CovarianceError: the covariance is not of this state, the vertices have no box, or `turns` are no modes.
        SolveError: the code has no surface, or no surface faces one of the sides.
    """
    checks.instance("prior", prior, ShapePrior, CovarianceError)
    of_one_object(state, covariance)
    if turns is not None:
        checks.instance("turns", turns, HeadingModes, CovarianceError)
    if prior.box is not None:
        centre, extents = state.T_world_object.translation(), state.scale * prior.box
        jacobian = np.eye(9, len(covariance.matrix))
    else:
        if p_object is None:
            p_object = np.asarray(extract_mesh(prior.decoder, state.code).vertices)
        p_object = checks.reals("p_object", p_object, (None, 3), PLACES, CovarianceError)
        if not len(p_object) or not (np.ptp(p_object, axis=0) > 0).all():
            raise CovarianceError(
                f"{len(p_object)} points have no box; give the vertices of the object's mesh"
            )
        jacobian = box_jacobian(prior.decoder, state, p_object)
        low, high = state.scale * p_object.min(axis=0), state.scale * p_object.max(axis=0)
        centre, extents = state.T_world_object.transformFrom((low + high) / 2), high - low
    known = covariance.mapped(jacobian, BOX_AXES)
    if turns is not None:
        known = replace(known, matrix=known.matrix + turns.second_moment(extents))
    return BoxPose(gtsam.Pose3(state.T_world_object.rotation(), centre), extents, known)


def box_jacobian(
    decoder: SdfDecoder, state: ObjectState, p_object: Float[np.ndarray, "v 3"]
) -> Float[np.ndarray, "9 9+l"]:
    """Derivative of the box's tangent w.r.t. the object's: pose, log-scale and code.

    A side moves as the surface that touches it does: by -(df/dz) / (df/dp) along its axis, where f is the SDF.
    """
    scale, length = state.scale, decoder.code_length
    sides, d_sides = np.zeros((2, 3)), np.zeros((2, 3, RIGID_DOF + length))
    for end, sign in enumerate((-1.0, 1.0)):
        for axis in range(3):
            reach = (sign * p_object[:, axis]).max()
            near = sign * p_object[:, axis] > reach - _OUTERMOST * np.ptp(p_object[:, axis])
            sides[end, axis] = sign * reach * scale[axis]
            d_sides[end, axis, 6 + axis] = sides[end, axis]
            moves = _moves(decoder, state.code, p_object[near], axis, sign)
            d_sides[end, axis, RIGID_DOF:] = scale[axis] * moves
    jacobian = np.zeros((9, RIGID_DOF + length))
    centre = sides.mean(axis=0)
    jacobian[:6, :6] = np.eye(6)
    jacobian[3:6, :3] = -gtsam.SO3.Hat(centre)
    jacobian[3:6] += d_sides.mean(axis=0)
    jacobian[6:] = (d_sides[1] - d_sides[0]) / (sides[1] - sides[0])[:, None]
    return jacobian


def _moves(
    decoder: SdfDecoder, code: np.ndarray, p_object: np.ndarray, axis: int, sign: float
) -> Float[np.ndarray, "l"]:
    """Derivative of where the surface at these points is along an axis w.r.t. the code, their mean."""
    like = decoder.like
    jet = decoder.linearize(torch.as_tensor(p_object).to(like), torch.as_tensor(code).to(like)[None])
    d_point, d_code = jet.d_point.double().cpu().numpy(), jet.d_code.double().cpu().numpy()
    cosine = sign * d_point[:, axis] / np.linalg.norm(d_point, axis=1).clip(1e-12)
    facing = cosine > min(_FACING, cosine.max() - 1e-9)
    if cosine.max() <= 0:
        raise SolveError(f"no surface faces the side of the box along {'-+'[sign > 0]}{'xyz'[axis]}")
    return -(d_code[facing] / d_point[facing, axis, None]).mean(axis=0)
