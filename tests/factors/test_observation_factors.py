"""The two factors against their definitions: loss, gradient, reduction, marginals, batching, guards."""

from typing import Any

import gtsam
import numpy as np
import pytest
import torch
from gtsam.symbol_shorthand import X

from factors.base import Annealing
from factors.batch import prefetch
from factors.depth import DepthFactor, RaySampling
from factors.errors import FactorError
from factors.full_distribution import FullDistribution
from factors.gaussian_depth import Probabilistic
from factors.rays import Rays
from factors.score import energy_score
from factors.state import ObjectKeys, ObjectState
from factors.surface import SurfaceFactor
from tests.factors.conftest import CODE_LENGTH, SphereDecoder, make_decoder, random_camera, random_state

KEYS = ObjectKeys.numbered(0)


def make_rays(rng: np.random.Generator, count: int = 30) -> Rays:
    directions = np.c_[rng.normal(size=(count, 2)) * 0.1, np.ones(count)]
    hit, depth = rng.random(count) < 0.6, rng.uniform(2.2, 2.8, count)
    return Rays(directions, depth, hit, rng.choice([2.7, np.inf], count), np.full(count, 0.01))


def make_factor(kind: str, camera, rng: np.random.Generator, decoder=None):
    decoder = decoder or make_decoder()
    if kind.startswith("surface"):
        points = rng.normal(size=(40, 3)) * 0.2 + [0, 0, 2.5]
        covariance = np.full(9 + CODE_LENGTH, 1e-4) if kind == "surface-propagated" else None
        return SurfaceFactor(
            KEYS, decoder, camera, points, np.full(40, 0.02), prior_sigma=0.02, state_covariance=covariance,
            tail=0.05 if kind == "surface-bounded" else None,
        )  # fmt: skip
    renderers = {
        "depth-full": FullDistribution(),
        "depth-paper": Probabilistic(),
    }
    return DepthFactor(
        KEYS, decoder, camera, make_rays(rng), renderer=renderers[kind], prior_sigma=0.02,
        share=0.3, sampling=RaySampling(coarse=8, cells=6),
    )  # fmt: skip


CAMERAS = ["fixed", "variable", "on a body"]
BODY_T_CAMERA = gtsam.Pose3(gtsam.Rot3.RzRyRx(-1.6, 0.1, -1.5), np.array([0.3, -0.1, 0.8]))
KINDS = ["surface", "surface-propagated", "surface-bounded", "depth-full", "depth-paper"]


def problem(kind: str, camera: str, seed: int, angle: float | None = None) -> tuple[Any, gtsam.Values]:
    """A factor, which the tests may open, and the values it was made at."""
    rng = np.random.default_rng(seed)
    state, T_world_camera, values = random_state(rng, angle), random_camera(rng), gtsam.Values()
    state.insert(values, KEYS)
    values.insert(X(3), T_world_camera)
    factor = make_factor(kind, T_world_camera if camera == "fixed" else X(3), rng)
    if camera == "on a body":
        factor.body_T_camera = BODY_T_CAMERA
        values.update(X(3), T_world_camera.compose(BODY_T_CAMERA.inverse()))
    factor.refresh(values, Annealing(slope=60.0))
    return factor, values


def moved(values: gtsam.Values, keys, dims, delta: np.ndarray) -> gtsam.Values:
    step = gtsam.VectorValues()
    for key, part in zip(keys, np.split(delta, np.cumsum(dims)[:-1]), strict=True):
        step.insert(key, part)
    return values.retract(step)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("camera", CAMERAS)
@pytest.mark.parametrize("angle", [1e-7, 1.0, np.pi - 1e-7])
def test_error_is_the_loss_and_gradient_is_its(kind, camera, angle):
    factor, values = problem(kind, camera, seed=5, angle=angle)
    graph = gtsam.NonlinearFactorGraph()
    graph.push_back(factor.gtsam_factor())
    assert graph.error(values) == pytest.approx(factor.loss(values), rel=1e-9)
    linear = graph.linearize(values)
    jacobian, b = linear.jacobian(gtsam.Ordering(factor.keys))
    assert 0.5 * b @ b == pytest.approx(factor.loss(values), rel=1e-9)
    gradient = -jacobian.T @ b
    dof, step = sum(factor.dims), 1e-6
    numeric = np.zeros(dof)
    for i in range(dof):
        delta = np.zeros(dof)
        delta[i] = step
        up = factor.loss(moved(values, factor.keys, factor.dims, delta))
        down = factor.loss(moved(values, factor.keys, factor.dims, -delta))
        numeric[i] = (up - down) / (2 * step)
    assert np.abs(gradient - numeric).max() < 1e-5 * np.abs(numeric).max()


@pytest.mark.parametrize("kind", ["depth-full", "depth-paper"])
@pytest.mark.parametrize("camera", CAMERAS)
def test_rendered_quantity_jacobian(kind, camera):
    """Expected transmittance and rendered depth, through retract, with the majoriser's weights held."""
    factor, values = problem(kind, camera, seed=9)
    query = factor.query(values)
    value = factor.decoder(query.p_object, query.code[None])
    rendered = factor._render(query, value).rows
    scale = 1.0
    if kind == "depth-paper":  # rows are sqrt(w) * (mean - observed): compare the mean itself
        error = _mean_depth(factor, values)
        scale = (rendered.residual[:, 0] / error).numpy()

    def quantity(at):
        if kind == "depth-paper":
            return _mean_depth(factor, at).numpy()
        query = factor.query(at)
        return (
            factor._render(query, factor.decoder(query.p_object, query.code[None]))
            .rows.residual.numpy()
            .ravel()
        )

    jet = factor.decoder.linearize(query.p_object[factor.active(query, value)], query.code[None])
    rows = factor._quantity_jacobian(query, value, jet, rendered.d_sdf).numpy()
    if kind == "depth-paper":
        rows = rows / np.where(scale == 0, 1, scale)[:, None]
    dof, step = sum(factor.dims), 1e-6
    numeric = np.zeros((len(rows), dof))
    for i in range(dof):
        delta = np.zeros(dof)
        delta[i] = step
        up = quantity(moved(values, factor.keys, factor.dims, delta))
        down = quantity(moved(values, factor.keys, factor.dims, -delta))
        numeric[:, i] = (up - down) / (2 * step)
    counts = np.broadcast_to(scale, len(rows)) != 0
    assert np.abs(numeric).max() > 0.01
    assert np.abs(rows - numeric)[counts].max() < 1e-5 * np.abs(numeric).max()


def _mean_depth(factor, values):
    from factors.occupancy import depth_mean, quadrature_moments

    frozen, query = factor._held, factor.query(values)
    value = factor.decoder(query.p_object, query.code[None])
    sdf = (frozen.metric.at(query.state) * value).view_as(frozen.cells.depth)
    moments = quadrature_moments(sdf, frozen.sdf_sigma, frozen.slope)
    escape = 1.1 * frozen.cells.far
    mean = depth_mean(moments.mean, frozen.cells.depth, escape)
    return mean - torch.where(frozen.targets.hit, frozen.targets.depth, escape)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("camera", CAMERAS)
def test_marginals_of_the_reduced_factor_are_those_of_all_rows(kind, camera):
    factor, values = problem(kind, camera, seed=6)
    rows = factor.rows(values)
    hessian = (rows.jacobian.T @ rows.jacobian).numpy() + np.eye(sum(factor.dims))
    graph = gtsam.NonlinearFactorGraph()
    graph.push_back(factor.gtsam_factor())
    for key, dim in zip(factor.keys, factor.dims, strict=True):
        noise = gtsam.noiseModel.Unit.Create(dim)
        if dim == 6:
            graph.push_back(gtsam.PriorFactorPose3(key, values.atPose3(key), noise))
        else:
            graph.push_back(gtsam.PriorFactorVector(key, values.atVector(key), noise))
    marginals = gtsam.Marginals(graph, values)
    expected = np.linalg.inv(hessian)
    starts = np.cumsum([0, *factor.dims])
    for i, key in enumerate(factor.keys):
        block = expected[starts[i] : starts[i + 1], starts[i] : starts[i + 1]]
        np.testing.assert_allclose(marginals.marginalCovariance(key), block, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("kind", KINDS)
def test_batched_decoding_changes_nothing(kind):
    factor, values = problem(kind, "variable", seed=7)
    other, other_values = problem("surface", "variable", seed=8)
    other.decoder = factor.decoder
    values_alone, rows_alone = factor.loss(values), factor.rows(values)
    other_alone = other.loss(values)
    factor._decoded = other._decoded = None
    prefetch([factor, other], values, jacobian=True)
    assert factor.known_jet(factor.query(values)) is not None
    assert factor.loss(values) == pytest.approx(values_alone, rel=1e-12)
    assert other.loss(values) == pytest.approx(other_alone, rel=1e-12)
    torch.testing.assert_close(factor.rows(values).jacobian, rows_alone.jacobian)
    assert factor.known_value(factor.query(other_values)) is None


@pytest.mark.parametrize("kind", KINDS)
def test_own_pose_and_key_agree_where_the_camera_is_the_same(kind):
    fixed, values = problem(kind, "fixed", seed=4)
    free, _ = problem(kind, "variable", seed=4)
    assert fixed.loss(values) == pytest.approx(free.loss(values), rel=1e-12)
    columns = 9 + CODE_LENGTH
    torch.testing.assert_close(fixed.rows(values).jacobian, free.rows(values).jacobian[:, :columns])


def test_a_camera_at_the_objects_own_key_is_refused():
    with pytest.raises(FactorError, match="o0 is the object's own: the camera needs another key"):
        make_factor("surface", KEYS.pose, np.random.default_rng(0))


def test_code_of_another_length_is_named():
    factor, values = problem("surface", "fixed", seed=0)
    values.update(KEYS.code, np.zeros(CODE_LENGTH))
    values.erase(KEYS.code)
    values.insert(KEYS.code, np.zeros(CODE_LENGTH + 2))
    with pytest.raises(FactorError, match=f"z0 holds a code of length {CODE_LENGTH + 2}"):
        factor.loss(values)


def test_a_residual_that_is_not_finite_names_the_keys():
    factor, values = problem("surface", "variable", seed=0)
    with torch.no_grad():
        factor.decoder.output.bias.fill_(torch.nan)
    factor._decoded = None
    graph = gtsam.NonlinearFactorGraph()
    graph.push_back(factor.gtsam_factor())
    for evaluate in (graph.error, graph.linearize):
        with pytest.raises(FactorError, match=r"SurfaceFactor\(o0, s0, z0, x3\).*not finite"):
            evaluate(values)


@pytest.mark.parametrize("tail", [0.0, -1.0, float("nan")])
def test_a_tail_that_is_none_is_refused(tail):
    with pytest.raises(FactorError, match="tail"):
        SurfaceFactor(KEYS, make_decoder(), gtsam.Pose3(), np.ones((4, 3)), np.full(4, 0.01), tail=tail)


def test_what_the_mask_holds_of_something_else_pulls_a_bounded_factor_nowhere():
    """A quarter of the points lies a metre behind: the gradient stays that of the others."""
    rng = np.random.default_rng(3)
    state, values = random_state(rng), gtsam.Values()
    state.insert(values, KEYS)
    near = state.to_world(rng.normal(size=(60, 3)) * 0.02)
    far = near[:20] + [1.0, 0, 0]
    gradients = {}
    for tail in (None, 0.05):
        for points in (near, np.concatenate([near, far])):
            factor = SurfaceFactor(
                KEYS, make_decoder(), gtsam.Pose3(), points, np.full(len(points), 0.01), tail=tail
            )
            factor.refresh(values)
            gradient = factor.gtsam_factor().linearize(values).augmentedInformation()[:-1, -1]
            gradients[tail, len(points)] = gradient
    moved = {tail: np.linalg.norm(gradients[tail, 80] - gradients[tail, 60]) for tail in (None, 0.05)}
    assert moved[0.05] < 0.02 * moved[None]


@pytest.mark.parametrize("tail", [None, 0.03])
@pytest.mark.parametrize("slope", [Annealing.slope, 90.0])
def test_the_surface_s_loss_is_its_definition(tail, slope):
    """Energy scores of metric distances to a sphere, each with the curvature of its share of one measurement."""
    rng, size, radius, prior_sigma = np.random.default_rng(0), 0.6, 0.5, 0.02
    state = ObjectState(gtsam.Pose3(), np.log(size) * np.ones(3), np.array([radius - 0.4, 0, 0, 0, 0]))
    camera = random_camera(rng)
    p_world = rng.normal(size=(40, 3))
    p_world *= (size * radius + rng.normal(size=(40, 1)) * 0.03) / np.linalg.norm(
        p_world, axis=1, keepdims=True
    )
    sensor, share = rng.uniform(0.005, 0.05, 40), rng.uniform(0.1, 1.0, 40)
    p_camera = (p_world - camera.translation()) @ camera.rotation().matrix()
    factor = SurfaceFactor(
        KEYS, SphereDecoder(), camera, p_camera, sensor, prior_sigma=prior_sigma, share=share, tail=tail
    )
    values = gtsam.Values()
    state.insert(values, KEYS)
    factor.refresh(values, Annealing(slope))
    mu = torch.as_tensor(np.linalg.norm(p_world, axis=1) - size * radius)
    sigma = torch.as_tensor(np.sqrt(sensor**2 + (prior_sigma * size) ** 2))
    score = energy_score(mu, sigma)
    if tail is not None:
        longer = tail * np.sqrt(Annealing.slope / slope)
        score = longer * torch.arctan(score / longer)
    expected = (torch.as_tensor(share) * np.sqrt(np.pi / 2) / sigma * score).sum()
    assert factor.loss(values) == pytest.approx(float(expected), rel=1e-9)
    assert factor.measurements == pytest.approx(share.sum())


@pytest.mark.parametrize(
    "given", [np.zeros((9 + 5, 9)), np.full(9 + 5, -1.0), np.diag([-1.0, *np.ones(9 + 4)])]
)
def test_a_covariance_of_the_state_that_is_none_is_refused(given):
    with pytest.raises(FactorError, match="state_covariance has"):
        SurfaceFactor(
            KEYS, make_decoder(), gtsam.Pose3(), np.ones((4, 3)), np.full(4, 0.01), state_covariance=given
        )


@pytest.mark.parametrize("points", [np.zeros((0, 3)), np.zeros((4, 2)), np.full((4, 3), np.nan)])
def test_bad_points_are_refused(points):
    with pytest.raises(FactorError, match="surface points"):
        SurfaceFactor(KEYS, make_decoder(), gtsam.Pose3(), points, np.full(len(points), 0.01))


@pytest.mark.parametrize("camera", CAMERAS)
@pytest.mark.parametrize("hits", [False, True])
def test_rays_that_all_miss_the_object_pull_it_nowhere_and_only_hits_cost(hits, camera):
    factor, values = problem("depth-full", camera, seed=5)
    factor._rays = factor._rays.take(np.flatnonzero(factor._rays.hit == hits))
    T = values.atPose3(KEYS.pose)
    values.update(KEYS.pose, gtsam.Pose3(T.rotation(), T.translation() + np.array([50.0, 0, 0])))
    factor.refresh(values)
    prefetch([factor], values, jacobian=True)
    graph = gtsam.NonlinearFactorGraph()
    graph.push_back(factor.gtsam_factor())
    assert (graph.error(values) > 1) if hits else (graph.error(values) == 0)
    assert np.abs(graph.linearize(values).jacobian()[0]).max() == 0


class CountingDecoder:
    """Counts what a decoder is asked, and may answer NaN."""

    def __init__(self, decoder) -> None:
        self.decoder, self.asked, self.broken = decoder, 0, False

    def __getattr__(self, name: str):
        return getattr(self.decoder, name)

    def __call__(self, points, *rest):
        self.asked += 1
        return self.decoder(points, *rest) * (np.nan if self.broken else 1.0)

    def linearize(self, points, *rest):
        self.asked += 1
        jet = self.decoder.linearize(points, *rest)
        return jet._replace(value=jet.value * (np.nan if self.broken else 1.0))


@pytest.mark.parametrize("kind", ["surface", "depth-full"])
def test_freezing_again_where_it_was_frozen_asks_nothing(kind):
    factor, values = problem(kind, "variable", seed=3)
    factor.decoder = counting = CountingDecoder(factor.decoder)
    factor.refresh(values, Annealing(slope=60.0))
    assert counting.asked == 0
    factor.refresh(values, Annealing(slope=90.0))
    asked = counting.asked
    assert asked > 0
    values.update(X(3), values.atPose3(X(3)).retract(np.full(6, 1e-3)))
    factor.refresh(values, Annealing(slope=90.0))
    assert counting.asked > asked


@pytest.mark.parametrize("kind", ["surface", "depth-full"])
def test_what_could_not_be_decoded_is_asked_for_again(kind):
    factor, values = problem(kind, "fixed", seed=3)
    before = factor.loss(values)
    factor.decoder = counting = CountingDecoder(factor.decoder)
    counting.broken = True
    factor.refresh(values, Annealing(slope=90.0))
    prefetch([factor], values, jacobian=True)
    counting.broken = False
    factor.refresh(values, Annealing(slope=90.0))
    factor.refresh(values, Annealing(slope=60.0))
    assert factor.loss(values) == pytest.approx(before, rel=1e-12)


def test_no_cell_lies_beyond_where_its_ray_ends():
    factor, _ = problem("depth-full", "fixed", seed=4)
    frozen = factor._held
    ends = torch.minimum(frozen.targets.end, frozen.cells.far)
    last = frozen.cells.depth[:, -1] + 0.5 * frozen.cells.width[:, -1]
    assert (ends < frozen.cells.far).any()
    torch.testing.assert_close(last, ends)


@pytest.mark.parametrize("renderer", ["full", Probabilistic])
def test_what_is_no_renderer_is_refused(renderer):
    with pytest.raises(FactorError, match="is no renderer"):
        DepthFactor(
            KEYS, make_decoder(), gtsam.Pose3(), make_rays(np.random.default_rng(0)), renderer=renderer
        )


def test_a_camera_that_the_values_do_not_hold_is_named():
    factor, values = problem("surface", "variable", seed=0)
    values.erase(X(3))
    with pytest.raises(FactorError, match="the values hold no camera at x3"):
        factor.refresh(values)


@pytest.mark.parametrize("kind", ["surface", "depth-full"])
def test_what_is_not_frozen_has_no_loss(kind):
    factor, values = problem(kind, "fixed", 0)
    query = factor.query(values)
    value = factor.decoder(query.p_object, query.code[None]).detach()
    fresh = make_factor(kind, gtsam.Pose3(), np.random.default_rng(0))
    with pytest.raises(FactorError, match="must be refreshed"):
        fresh.loss_of(query, value)
