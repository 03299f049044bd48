"""A small smooth decoder in float64 and random states, near zero rotation and near pi."""

import gtsam
import numpy as np
import pytest
import torch

from factors.base import ObservationFactor
from factors.decoder import Decoder, DecoderConfig
from factors.state import ObjectKeys, ObjectState

CODE_LENGTH = 5


class RoughSphere(Decoder):
    """A sphere dented by a random network: signs on both sides and no derivative that vanishes."""

    def _network(self, points, injected):
        return points.square().sum(dim=1).add(0.01).sqrt() - 0.4 + 0.3 * super()._network(points, injected)


def make_decoder(seed: int = 0, **settings) -> Decoder:
    torch.manual_seed(seed)
    config = DecoderConfig(**{"code_length": CODE_LENGTH, "width": 16, "depth": 3, "skip": 1, **settings})
    decoder = RoughSphere(config).double()
    with torch.no_grad():
        for parameter in decoder.parameters():
            parameter.mul_(2.0)
    return decoder.requires_grad_(False)


class SphereDecoder(Decoder):
    """A sphere of radius 0.4 + code[0]: an exact distance field with a code."""

    def __init__(self) -> None:
        super().__init__(DecoderConfig(code_length=CODE_LENGTH, width=4, depth=2, skip=0))
        self.double()

    def _network(self, points, injected):
        return points.norm(dim=1) - 0.4 - injected["0"][:, 0]

    def _enter(self, codes):
        return {"0": codes[:, :1]}

    def _d_enter(self, codes):
        return {"0": torch.eye(CODE_LENGTH).to(codes)[None, :1]}


@pytest.fixture
def decoder() -> Decoder:
    return make_decoder()


@pytest.fixture
def keys() -> ObjectKeys:
    return ObjectKeys.numbered(0)


def random_state(rng: np.random.Generator, angle: float | None = None) -> ObjectState:
    axis = rng.normal(size=3)
    angle = rng.uniform(0, np.pi) if angle is None else angle
    rotation = gtsam.Rot3.Expmap(angle * axis / np.linalg.norm(axis))
    return ObjectState(
        gtsam.Pose3(rotation, rng.normal(size=3) * 0.3),
        rng.uniform(-0.3, 0.3, size=3),
        rng.normal(size=CODE_LENGTH) * 0.5,
    )


def random_camera(rng: np.random.Generator, distance: float = 2.5) -> gtsam.Pose3:
    """T_world_camera of a camera near (0, 0, -distance) that looks at the world's origin."""
    rotation = gtsam.Rot3.Expmap(rng.normal(size=3) * 0.1)
    return gtsam.Pose3(rotation, np.array([0, 0, -distance]) + rng.normal(size=3) * 0.1)


def assert_gtsam_has(factor: ObservationFactor, values: gtsam.Values, gradient: np.ndarray) -> None:
    """The factor's loss, and this as its gradient."""
    graph = gtsam.NonlinearFactorGraph()
    graph.push_back(factor.gtsam_factor())
    assert graph.error(values) == pytest.approx(factor.loss(values), rel=1e-9)
    A, b = graph.linearize(values).at(0).jacobian()
    np.testing.assert_allclose(-A.T @ b, gradient, rtol=1e-7, atol=1e-7 * np.abs(gradient).max())
