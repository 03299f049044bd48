"""The metric SDF of an uncertain object: its derivative is that of the distance, on the surface and away from it."""

import gtsam
import numpy as np
import pytest
import torch

from factors.sdf_decoder import SdfDecoder
from factors.state import ObjectState
from objgraph.covariance.depth import predicted_depth
from objgraph.covariance.labelled import ObjectCovariance
from objgraph.covariance.surface import metric_sdf_jacobian, surface_sigma
from objgraph.errors import CovarianceError
from tests.factors.conftest import CODE_LENGTH, SphereDecoder


class PlaneDecoder(SphereDecoder):
    """A slanted half space, which a code moves: one gradient everywhere, so that holding it leaves nothing out."""

    def _network(self, points, injected):
        normal = torch.tensor([2.0, 1.0, 2.0]).to(points) / 3
        return points @ normal - 0.1 - injected["0"][:, 0]


def numerical(decoder: SdfDecoder, state: ObjectState, p_world: np.ndarray, step: float = 1e-5) -> np.ndarray:
    def sdf(delta: np.ndarray) -> np.ndarray:
        return metric_sdf_jacobian(decoder, state.retract(delta), p_world)[0].numpy()

    return np.stack([(sdf(step * e) - sdf(-step * e)) / (2 * step) for e in np.eye(9 + CODE_LENGTH)], axis=1)


@pytest.mark.parametrize("seed", range(3))
def test_of_a_plane_it_is_the_numerical_one_anywhere(seed):
    rng = np.random.default_rng(seed)
    pose = gtsam.Pose3(gtsam.Rot3.Expmap(rng.normal(size=3)), rng.normal(size=3))
    state = ObjectState(pose, rng.uniform(-0.4, 0.4, 3), rng.normal(size=CODE_LENGTH) * 0.1)
    p_world = state.to_world(rng.uniform(-0.5, 0.5, (30, 3)))
    sdf, jacobian, _ = metric_sdf_jacobian(PlaneDecoder(), state, p_world)
    assert sdf.abs().max() > 0.2
    np.testing.assert_allclose(jacobian, numerical(PlaneDecoder(), state, p_world), atol=1e-8)


def test_a_sphere_that_grows_comes_as_near_everywhere():
    """d(|p| - 0.4 s) / d log s = -0.4 s, whatever the distance."""
    state = ObjectState(gtsam.Pose3(), np.full(3, np.log(1.5)), np.zeros(CODE_LENGTH))
    p_world = state.to_world(np.random.default_rng(0).uniform(-0.5, 0.5, (30, 3)))
    _, jacobian, _ = metric_sdf_jacobian(SphereDecoder(), state, p_world)
    np.testing.assert_allclose(jacobian[:, 6:9].sum(dim=1), -0.4 * 1.5, atol=1e-9)
    expected = numerical(SphereDecoder(), state, p_world)
    np.testing.assert_allclose(jacobian[:, 6:9].sum(dim=1), expected[:, 6:9].sum(axis=1), atol=1e-6)


def test_what_is_no_decoder_or_no_state_is_told():
    """Such as the prior in place of its decoder."""
    state = ObjectState(gtsam.Pose3(), np.zeros(3), np.zeros(CODE_LENGTH))
    covariance = ObjectCovariance.diagonal(np.full(9 + CODE_LENGTH, 1e-4), "marginals")
    none, points = object(), np.array([[0.0, 0.0, 1.0]])
    with pytest.raises(CovarianceError, match="decoder must be of type SdfDecoder"):
        predicted_depth(none, state, covariance, gtsam.Pose3(), points)  # pyright: ignore[reportArgumentType]
    with pytest.raises(CovarianceError, match="decoder must be of type SdfDecoder"):
        surface_sigma(none, state, covariance, points)  # pyright: ignore[reportArgumentType]
    with pytest.raises(CovarianceError, match="state must be of type ObjectState"):
        surface_sigma(SphereDecoder(), none, covariance, points)  # pyright: ignore[reportArgumentType]
