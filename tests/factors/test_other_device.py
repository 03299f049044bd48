"""A decoder on another device than the factors: its answers come to them."""

import gtsam
import numpy as np
import pytest
import torch
from gtsam.symbol_shorthand import X

from factors.base import Annealing, ObservationFactor
from factors.batch import prefetch
from factors.filled_box import FilledBoxFactor
from factors.floor import FloorFactor
from factors.linearized import linearized
from factors.sdf_decoder import SdfDecoder
from tests.factors.conftest import make_decoder, random_camera, random_state
from tests.factors.other_device import ELSEWHERE, Far, FarDecoder, OtherDevice
from tests.factors.test_observation_factors import KEYS, KINDS, make_factor

ALL = [*KINDS, "filled-box", "floor"]


def values_at(seed: int) -> gtsam.Values:
    rng, values = np.random.default_rng(seed), gtsam.Values()
    random_state(rng).insert(values, KEYS)
    values.insert(X(3), random_camera(rng))
    return values


def factor_of(kind: str, decoder: SdfDecoder, variable_camera: bool) -> ObservationFactor:
    values = values_at(2)
    if kind == "filled-box":
        return FilledBoxFactor(KEYS, decoder, np.array([0.8, 0.9, 0.7]), 0.01)
    if kind == "floor":
        floor = values.atPose3(KEYS.pose).translation()[2] - 0.2
        return FloorFactor(KEYS, decoder, np.array([0.0, 0.0, 1.0]), floor, stands=0.4)
    camera = X(3) if variable_camera else values.atPose3(X(3))
    return make_factor(kind, camera, np.random.default_rng(2), decoder)


def quadratic(factor: ObservationFactor, batched: bool) -> tuple[float, np.ndarray]:
    """The loss and the Jacobian with its right-hand side, as GTSAM is told."""
    values, graph = values_at(2), gtsam.NonlinearFactorGraph()
    factor.refresh(values, Annealing(60.0))
    if batched:
        prefetch([factor], values, jacobian=True)
    graph.push_back(factor.gtsam_factor())
    graph.push_back(linearized([factor], values))
    return graph.error(values), graph.linearize(values).augmentedHessian()


@pytest.mark.parametrize("batched", [False, True])
@pytest.mark.parametrize("variable_camera", [False, True])
@pytest.mark.parametrize("kind", ALL)
def test_the_quadratic_is_the_same(kind, variable_camera, batched):
    here = quadratic(factor_of(kind, make_decoder(), variable_camera), batched)
    with OtherDevice():
        there = quadratic(factor_of(kind, FarDecoder(make_decoder()), variable_camera), batched)
    assert here[0] > 0
    assert there[0] == pytest.approx(here[0], rel=1e-12)
    np.testing.assert_allclose(there[1], here[1], rtol=1e-9, atol=1e-9)


def test_the_other_device_refuses_as_a_real_one_does():
    with OtherDevice():
        far, near = torch.zeros(3, device=ELSEWHERE), torch.zeros(3)
        assert isinstance(far, Far)
        assert (far.device, far.cpu().device) == (ELSEWHERE, near.device)
        with pytest.raises(RuntimeError, match="two devices"):
            torch.add(far, near)
        with pytest.raises(RuntimeError, match="two devices"):
            near[torch.tensor([0])] = far[:1]
        with pytest.raises(TypeError):
            far.numpy()
        assert type(far[torch.tensor([0])] * 2 + 1) is Far
        assert not isinstance(far.double().to(near), Far)
        assert isinstance(near.to(far), Far)
