"""The gradient of every factor at random states, through `retract`, against differences of its own error.

GRADIENTS=250 tries so many states of each kind; without it a few, the same every time.
"""

import os
from collections.abc import Callable
from typing import Any

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import X

from factors.base import Annealing
from factors.code_mixture import CodeMixture, mixture_prior
from factors.depth import DepthFactor, RaySampling
from factors.filled_box import FilledBoxFactor
from factors.floor import FloorFactor
from factors.full_distribution import FullDistribution
from factors.gaussian_depth import Deterministic, Probabilistic, Sampled, Uncentred
from factors.linearized import linearized
from factors.priors import code_prior, placed_prior, scale_prior, sized_prior, upright_prior
from factors.proportions import Proportions, proportions_prior
from factors.state import ObjectKeys, ObjectState
from factors.surface import SurfaceFactor
from tests.factors.conftest import CODE_LENGTH, make_decoder, random_camera, random_state
from tests.factors.test_observation_factors import BODY_T_CAMERA, CAMERAS, make_rays

STATES = int(os.environ.get("GRADIENTS", "4"))
"""Of each kind of factor and camera."""
KEYS = ObjectKeys.numbered(0)
STEP = 1e-6
DECODER = make_decoder()

SURFACES = {
    "surface": {},
    "surface of an uncertain state": {"state_covariance": np.full(9 + CODE_LENGTH, 1e-4)},
    "surface with a tail": {"tail": 0.05},
}
RENDERERS = {
    "comonotone": FullDistribution(),
    "every metre": FullDistribution(reach=None),
    "paper": Probabilistic(),
    "paper's by Sobol points": Probabilistic("sobol"),
    "released": Uncentred(),
    "sampled": Sampled(),
    "deterministic": Deterministic(),
}
SEEN = [*SURFACES, *RENDERERS]


def drawn_state(rng: np.random.Generator) -> ObjectState:
    """Of any rotation, next to none and to half a turn as well."""
    angles = (None, None, 1e-7, np.pi - 1e-7)
    return random_state(rng, angles[rng.integers(len(angles))])


def moved(values: gtsam.Values, dims: dict[int, int], delta: np.ndarray) -> gtsam.Values:
    step, parts = gtsam.VectorValues(), np.split(delta, np.cumsum(list(dims.values()))[:-1])
    for key, part in zip(dims, parts, strict=True):
        step.insert(key, part)
    return values.retract(step)


def dims_of(values: gtsam.Values, keys: list[int]) -> dict[int, int]:
    zero = values.zeroVectors()
    return {key: zero.at(key).size for key in keys}


def differences(error: Callable[[float], float], step: float) -> tuple[float, float, float]:
    """Backward, central and forward."""
    here, ahead, behind = error(0.0), error(step), error(-step)
    return (here - behind) / step, (ahead - behind) / (2 * step), (ahead - here) / step


def agrees(slope: float, error: Callable[[float], float], step: float, steepest: float) -> bool:
    """Whether this is the derivative of the error at 0 or, where it has a kink, between those of its sides.

    `steepest` is the gradient's norm: cells that hardly matter are left out of it.
    """
    slack = 5e-6 * max(1.0, steepest) + 1e-14 * abs(error(0.0)) / step
    low, central, high = differences(error, step)
    if abs(central - slope) < slack:
        return True
    nearer_low, _, nearer_high = differences(error, 0.1 * step)
    kinked = abs(nearer_high - nearer_low) > 0.5 * abs(high - low) > slack
    return kinked and min(low, high) - slack <= slope <= max(low, high) + slack


def check(
    graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, rng: np.random.Generator, step: float = STEP
) -> bool:
    """Along two random directions of all variables; whether there was a gradient."""
    keys = list(graph.at(0).keys())
    dims = dims_of(values, keys)
    ordering = gtsam.Ordering()
    for key in keys:
        ordering.push_back(key)
    A, b = graph.linearize(values).jacobian(ordering)
    assert 0.5 * b @ b == pytest.approx(graph.error(values), rel=1e-9, abs=1e-12)
    gradient = -A.T @ b
    for _ in range(2):
        along = rng.normal(size=len(gradient))
        along /= np.linalg.norm(along)
        assert agrees(
            float(gradient @ along),
            lambda by, along=along: graph.error(moved(values, dims, by * along)),
            step,
            float(np.linalg.norm(gradient)),
        )
    return bool(np.abs(gradient).max() > 1e-3)


def graph_of(factor) -> gtsam.NonlinearFactorGraph:
    graph = gtsam.NonlinearFactorGraph()
    graph.push_back(factor.gtsam_factor() if hasattr(factor, "gtsam_factor") else factor)
    return graph


def seen_problem(kind: str, camera: str, rng: np.random.Generator) -> tuple[Any, gtsam.Values]:
    """A factor of one view, frozen, and values that have since moved away a little."""
    state, T_world_camera, values = drawn_state(rng), random_camera(rng), gtsam.Values()
    body_T_camera = BODY_T_CAMERA if camera == "on a body" else None
    pose = T_world_camera if body_T_camera is None else T_world_camera.compose(body_T_camera.inverse())
    state.insert(values, KEYS)
    values.insert(X(3), pose)
    at = pose if camera == "fixed" else X(3)
    if kind in SURFACES:
        points = rng.normal(size=(30, 3)) * 0.2 + [0, 0, 2.5]
        factor = SurfaceFactor(
            KEYS, DECODER, at, points, np.full(30, 0.02), prior_sigma=0.02, body_T_camera=body_T_camera,
            **SURFACES[kind],
        )  # fmt: skip
    else:
        factor = DepthFactor(
            KEYS, DECODER, at, make_rays(rng, 20), renderer=RENDERERS[kind], prior_sigma=0.02,
            share=0.3, sampling=RaySampling(coarse=8, cells=6),
            body_T_camera=body_T_camera,
        )  # fmt: skip
    factor.refresh(values, Annealing(slope=float(rng.choice([60.0, 120.0, 400.0]))))
    dims = dims_of(values, factor.keys)
    return factor, moved(values, dims, 0.01 * rng.normal(size=sum(dims.values())))


@pytest.mark.parametrize("camera", CAMERAS)
@pytest.mark.parametrize("kind", SEEN)
def test_what_a_view_says(kind, camera):
    steep = 0
    for seed in range(STATES):
        rng = np.random.default_rng([SEEN.index(kind), CAMERAS.index(camera), seed])
        factor, values = seen_problem(kind, camera, rng)
        steep += check(graph_of(factor), values, rng)
    assert steep >= 0.4 * STATES  # rays may all miss, and ends within the box say nothing


@pytest.mark.parametrize("kind", ["surface", "comonotone", "every metre"])
def test_the_rows_are_derivatives_of_what_they_say(kind):
    """Of the signed distances in metres, and of every cell's residual, with the weights held."""
    for seed in range(STATES):
        rng = np.random.default_rng([7, SEEN.index(kind), seed])
        factor, values = seen_problem(kind, "on a body", rng)
        dims = dims_of(values, factor.keys)
        along = rng.normal(size=sum(dims.values()))
        along /= np.linalg.norm(along)
        query = factor.query(values)
        value, jet = factor._value(query), factor._jet(query)
        if kind == "surface":
            rows = factor._held.metric.jacobian(query.state, value, factor.sdf_jacobian(query, jet))
        else:
            rows = factor._quantity_jacobian(query, value, jet, factor._render(query, value).rows.d_sdf)

        def quantity(step, factor=factor, values=values, dims=dims, along=along):
            query = factor.query(moved(values, dims, step * along))
            value = factor._value(query)
            if kind == "surface":
                return (factor._held.metric.at(query.state) * value).numpy()
            return factor._render(query, value).rows.residual.numpy().ravel()

        here, ahead, behind = quantity(0.0), quantity(STEP), quantity(-STEP)
        slope = rows.numpy() @ along
        smooth = np.abs(ahead - 2 * here + behind) < 1e-9  # not at the kink of a running minimum
        assert smooth.sum() >= 0.9 * len(smooth)
        np.testing.assert_allclose(
            slope[smooth], ((ahead - behind) / (2 * STEP))[smooth], rtol=1e-4, atol=1e-5
        )


def floor_factor(rng: np.random.Generator, state: ObjectState, stands: float | None) -> FloorFactor:
    up = rng.normal(size=3)
    up /= np.linalg.norm(up)
    height = float(up @ state.T_world_object.translation()) - rng.uniform(0.2, 0.45)
    return FloorFactor(KEYS, DECODER, up, height, stands=stands, prior_sigma=0.02)


def own_factor(kind: str, rng: np.random.Generator, state: ObjectState) -> Any:
    """A factor on an object's variables alone."""
    root = rng.normal(size=(CODE_LENGTH, CODE_LENGTH))
    near = state.retract(0.2 * rng.normal(size=9 + CODE_LENGTH))
    if kind == "code":
        return code_prior(KEYS, near.code, root @ root.T + np.eye(CODE_LENGTH))
    if kind == "scale":
        return scale_prior(KEYS, near.log_scale[0], 0.3, 0.1)
    if kind == "upright":
        return upright_prior(KEYS, rng.normal(size=3), 0.05)
    if kind == "placed":
        return placed_prior(KEYS, near.T_world_object, 0.1, 0.3, 0.2)
    if kind == "sized":
        return sized_prior(KEYS, near.log_scale, 0.1)
    if kind == "proportions":
        slope = rng.normal(size=(3, CODE_LENGTH))
        known = Proportions(rng.normal(size=3), slope, 0.1 * np.eye(3) + 0.05)
        return proportions_prior(KEYS, known, near.log_scale[0], 0.3)
    if kind == "kinds":
        mean = near.code + rng.normal(size=(3, CODE_LENGTH))
        return mixture_prior(KEYS, CodeMixture(np.full(3, 1 / 3), mean, rng.uniform(0.5, 2, mean.shape)))
    if kind == "filled box":
        return FilledBoxFactor(KEYS, DECODER, rng.uniform(0.6, 1.2, 3), 0.02)
    return floor_factor(rng, state, 0.4 if kind == "standing" else None)


OWN = [
    "code",
    "scale",
    "upright",
    "placed",
    "sized",
    "proportions",
    "kinds",
    "filled box",
    "floor",
    "standing",
]


@pytest.mark.parametrize("kind", OWN)
def test_what_is_known_of_an_object_beside_its_views(kind):
    steep = 0
    for seed in range(STATES):
        rng = np.random.default_rng([11, OWN.index(kind), seed])
        state, values = drawn_state(rng), gtsam.Values()
        state.insert(values, KEYS)
        factor = own_factor(kind, rng, state)
        if hasattr(factor, "refresh"):
            factor.refresh(values, Annealing(slope=60.0))
            dims = dims_of(values, [*KEYS])
            values = moved(values, dims, 0.01 * rng.normal(size=sum(dims.values())))
        steep += check(graph_of(factor), values, rng)
    assert steep >= 0.4 * STATES


def test_the_quadratic_of_a_view_has_its_gradient_where_it_was_taken():
    for seed in range(STATES):
        rng = np.random.default_rng([13, seed])
        factor, values = seen_problem("comonotone", "variable", rng)
        quadratic = graph_of(linearized([factor], values)).linearize(values)
        own = graph_of(factor).linearize(values)
        expected = own.gradientAtZero()
        for key in factor.keys:
            np.testing.assert_allclose(
                quadratic.gradientAtZero().at(key), expected.at(key), rtol=1e-6, atol=1e-6
            )
