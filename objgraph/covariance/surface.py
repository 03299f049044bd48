"""What an object's covariance means on its surface."""

import gtsam
import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from factors import checks
from factors.checks import PLACES
from factors.sdf import MetricSdf, propagated_variance, query_points, sdf_jacobian
from factors.sdf_decoder import SdfDecoder
from factors.state import ObjectState
from objgraph.covariance.labelled import ObjectCovariance, of_one_object
from objgraph.errors import CovarianceError, SolveError


def surface_sigma(
    decoder: SdfDecoder,
    state: ObjectState,
    covariance: ObjectCovariance,
    p_object: Float[np.ndarray, "n 3"],
) -> Float[np.ndarray, "n"]:
    """Standard deviation, metres, of the surface along its normal at canonical points on it.

    Raises:
        CovarianceError: the covariance is not of this state, or the points are none.
    """
    checks.instance("state", state, ObjectState, CovarianceError)
    p_object = checks.reals("p_object", p_object, (None, 3), PLACES, CovarianceError)
    return metric_sdf(decoder, state, covariance, state.to_world(p_object))[1].numpy()


def metric_sdf(
    decoder: SdfDecoder,
    state: ObjectState,
    covariance: ObjectCovariance,
    p_world: Float[np.ndarray, "n 3"],
) -> tuple[Float[Tensor, "n"], Float[Tensor, "n"], Float[Tensor, "n"]]:
    """Signed distance at world points and its standard deviation sqrt(diag(J Σ J^T)) (paper eq:sdf_variance).

    Both in metres; last, metres per unit of the decoder's own values.
    """
    of_one_object(state, covariance)
    sdf, jacobian, metres = metric_sdf_jacobian(decoder, state, p_world)
    matrix = torch.as_tensor(np.array(covariance.matrix), dtype=jacobian.dtype)
    sigma = propagated_variance(jacobian, matrix).clamp_min(0).sqrt()
    return sdf, sigma, metres


def metric_sdf_jacobian(
    decoder: SdfDecoder, state: ObjectState, p_world: Float[np.ndarray, "n 3"]
) -> tuple[Float[Tensor, "n"], Float[Tensor, "n d"], Float[Tensor, "n"]]:
    """Signed distance at world points, metres, and its derivative w.r.t. pose, log-scale and code (see `MetricSdf`).

    Last, metres per unit of the decoder's own values. All on the processor. Raises SolveError where the decoder's answer
    is not finite.
    """
    checks.instance("decoder", decoder, SdfDecoder, CovarianceError)
    # with the camera at the world's origin, camera points are world points
    query = query_points(decoder, state, gtsam.Pose3(), p_world)
    jet = decoder.linearize(query.p_object, query.code[None])
    if not (jet.value.isfinite().all() and jet.d_point.isfinite().all() and jet.d_code.isfinite().all()):
        raise SolveError(
            "the decoder's SDF is not finite at the points asked about: the shape code has diverged"
        )
    metric = MetricSdf.of(jet.d_point, state)
    jacobian = metric.jacobian(state, jet.value, sdf_jacobian(query, jet, camera=False))
    return (metric.metres * jet.value.double()).cpu(), jacobian.cpu(), metric.metres.cpu()
