"""Signed distances of measured points to an object, and their Jacobians.

The chain rule of design: with f = G(z, p_object), g = df/dp_object, q = R^T (p_world - t), h = g * exp(-s) the
rows are h^T [q]x, -h^T, -(g * p_object), df/dz, and for the camera h^T R^T R_c [-[p_camera]x, I]
(paper eq:jacobian_code, eq:jacobian_pose, carried through GTSAM's body-frame `retract`).
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import gtsam
import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from factors.sdf_decoder import SdfDecoder, SdfJet
from factors.state import POSE_DOF, RIGID_DOF, ObjectState

_GRADIENT_RANGE = (0.5, 2.0)
"""A true distance field has gradient norm 1; a decoder's is trusted within these bounds."""


@dataclass(frozen=True)
class SdfQuery:
    """Measured points in canonical coordinates, ready to be decoded."""

    p_object: Float[Tensor, "n 3"]
    code: Float[Tensor, "l"]
    state: ObjectState
    T_world_camera: gtsam.Pose3
    p_camera: Float[np.ndarray, "n 3"]

    @cached_property
    def fingerprint(self) -> bytes:
        """Equal where a decoder would answer the same."""
        state = self.state
        parts = (
            self.p_object.cpu().numpy(),
            state.log_scale,
            state.code,
            state.T_world_object.matrix(),
        )
        return b"".join(np.ascontiguousarray(part).tobytes() for part in parts)

    def take(self, indices: Int[Tensor, "m"]) -> "SdfQuery":
        """Some of the points."""
        return replace(
            self,
            p_object=self.p_object[indices.to(self.p_object.device)],
            p_camera=self.p_camera[indices.cpu().numpy()],
        )


def query_points(
    decoder: SdfDecoder,
    state: ObjectState,
    T_world_camera: gtsam.Pose3,
    p_camera: Float[np.ndarray, "n 3"],
) -> SdfQuery:
    """Camera points in the object's canonical frame, in the decoder's precision."""
    p_world = p_camera @ T_world_camera.rotation().matrix().T + T_world_camera.translation()
    like = decoder.like
    return SdfQuery(
        torch.as_tensor(state.to_object(p_world), dtype=like.dtype, device=like.device),
        torch.as_tensor(np.array(state.code), dtype=like.dtype, device=like.device),
        state,
        T_world_camera,
        p_camera,
    )


def metres_per_unit(d_point: Float[Tensor, "n 3"], state: ObjectState) -> Float[Tensor, "n"]:
    """First-order metric length of one canonical SDF unit at each point: 1 / ||h||.

    The decoder's own gradient norm is clipped to a factor of two about 1, so that a flat spot of the network
    far from the surface cannot blow a residual up.
    """
    scale = torch.as_tensor(state.scale, dtype=d_point.dtype, device=d_point.device)
    norm = d_point.norm(dim=1)
    flat = norm == 0  # its slope has no direction: as long as the mean of the axes
    shrink = torch.where(flat, (1 / scale).log().mean().exp(), (d_point / scale).norm(dim=1) / norm)
    return 1.0 / (norm.clamp(*_GRADIENT_RANGE) * shrink).clamp_min(1e-6)


def sdf_jacobian(query: SdfQuery, jet: SdfJet, camera: bool) -> Float[Tensor, "n d"]:
    """Derivative of the canonical SDF w.r.t. [rotation, translation, log-scale, code (, camera)]."""
    dtype, device = jet.d_point.dtype, jet.d_point.device
    scale = torch.as_tensor(query.state.scale, dtype=dtype, device=device)
    h = jet.d_point / scale
    # q is p_object in metres; h^T [q]x = (q x h)^T up to sign: h . (q x w) = w . (h x q)
    p_object = query.p_object.to(device)  # the decoder's may be another than the jet's
    q = p_object * scale
    columns = [torch.linalg.cross(h, q), -h, -(jet.d_point * p_object), jet.d_code]
    if camera:
        R_object_camera = (
            query.state.T_world_object.rotation().matrix().T @ query.T_world_camera.rotation().matrix()
        )
        in_camera = h @ torch.as_tensor(R_object_camera, dtype=dtype, device=device)
        p_camera = torch.as_tensor(query.p_camera, dtype=dtype, device=device)
        columns += [torch.linalg.cross(p_camera, in_camera), in_camera]
    return torch.cat(columns, dim=1)


class MetricSdf(NamedTuple):
    """Metres per canonical SDF unit at n points, as the object's scale changes and the decoder's gradient does not.

    Were they held as well, growing an object and shrinking its shape would lower every residual and leave the
    surface where it is.
    """

    metres: Float[Tensor, "n"]
    """At `log_scale`."""
    share: Float[Tensor, "n 3"]
    """d log metres / d log-scale: the squared components of the metric normal along the object's axes."""
    log_scale: Float[np.ndarray, "3"]

    @classmethod
    def of(cls, d_point: Float[Tensor, "n 3"], state: ObjectState) -> "MetricSdf":
        """Where the decoder has these gradients."""
        scale = torch.as_tensor(state.scale, dtype=torch.float64, device=d_point.device)
        normal = torch.nn.functional.normalize(d_point.double() / scale, dim=1, eps=1e-300)
        flat = d_point.norm(dim=1, keepdim=True) == 0  # no direction: as in `metres_per_unit` the axes' mean
        share = torch.where(flat, 1 / 3, normal.square())
        return cls(metres_per_unit(d_point, state).double(), share, np.array(state.log_scale))

    def at(self, state: ObjectState) -> Float[Tensor, "n"]:
        """Metres per canonical unit at another scale, to first order in its logarithm."""
        moved = torch.as_tensor(state.log_scale - self.log_scale, device=self.share.device)
        return self.metres * torch.exp(self.share @ moved)

    def jacobian(
        self, state: ObjectState, value: Float[Tensor, "n"], d_value: Float[Tensor, "n d"]
    ) -> Float[Tensor, "n d"]:
        """Derivative of the metric SDF, from the canonical one's value and derivative (see `sdf_jacobian`)."""
        metres = self.at(state)[:, None]
        rows = metres * d_value.double()
        rows[:, POSE_DOF:RIGID_DOF] += metres * value.double()[:, None] * self.share
        return rows

    def take(self, indices: Int[Tensor, "m"]) -> "MetricSdf":
        """At some of the points."""
        return MetricSdf(self.metres[indices], self.share[indices], self.log_scale)


def propagated_variance(
    jacobian: Float[Tensor, "n d"], covariance: Float[Tensor, "d d"] | Float[Tensor, "d"]
) -> Float[Tensor, "n"]:
    """Variance of the SDF under an uncertain state, J Σ J^T (paper eq:sdf_variance); Σ full or diagonal."""
    if covariance.ndim == 1:
        return jacobian.square() @ covariance
    return ((jacobian @ covariance) * jacobian).sum(dim=1)
