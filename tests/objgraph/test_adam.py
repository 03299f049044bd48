"""The paper's estimator and DSP-SLAM's Gauss-Newton: every derivative against a loss that is written here anew."""

from dataclasses import replace
from typing import Any

import gtsam
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import expit
from scipy.stats import norm

from factors.gaussian_depth import Deterministic, Probabilistic, Sampled
from factors.rays import box_interval
from factors.sdf import metres_per_unit, query_points, sdf_jacobian
from factors.state import RIGID_DOF, ObjectState
from objgraph.adam import AdamConfig, AdamEstimator, GaussNewtonConfig, GaussNewtonEstimator, terms
from objgraph.adam.estimator import _Descent
from objgraph.adam.pool import Pool
from objgraph.adam.terms import DrawnRays, Linearized, RaySteps, draw_rays, linearize
from objgraph.comparison.methods import METHODS
from objgraph.errors import SolveError
from objgraph.estimation import Estimate, EstimationTask, Estimator
from objgraph.sampling import ObjectView, SamplingConfig, observe
from objgraph.solve import LevenbergMarquardtConfig, SolverConfig
from tests.toys import TOY_CODE, ToyDecoder, toy_frame, toy_prior, toy_state

UP = np.array([0.0, 0.0, 1.0])
OFF = np.array([0.05, -0.08, 0.03, 0.02, -0.03, 0.02, 0.05, -0.05, 0.03, -0.317, 0.31, -0.23, 0.14])
"""A start: degrees, centimetres and some code away from the truth."""
DIM = RIGID_DOF + TOY_CODE
SMALL = AdamConfig(iterations=12, points=60, rays=40, steps=RaySteps(samples=30))
DECODER = ToyDecoder().double()
_VIEWS: dict[float, tuple[ObjectView, ...]] = {}


def views(heading: float = 0.4) -> tuple[ObjectView, ...]:
    """Two views of a toy chair."""
    if heading not in _VIEWS:
        state, sampling = toy_state(heading), SamplingConfig(points=150, hits=100, free=100)
        _VIEWS[heading] = tuple(
            observe(toy_frame([state], azimuth, seed=i), 1, sampling) for i, azimuth in enumerate((0.3, 2.0))
        )
    return _VIEWS[heading]


def task(heading: float = 0.4, decoder: ToyDecoder | None = None, **changes) -> EstimationTask:
    prior = replace(toy_prior(), decoder=decoder or DECODER, code_mean=np.array([0.1, -0.1, 0.05, 0.0]))
    given = {
        "name": f"chair at {heading}",
        "prior": prior,
        "starts": (toy_state(heading).retract(OFF),),
        "views": views(heading),
        "up_world": UP,
    }
    return EstimationTask(**(given | changes))


def pose_error(found: ObjectState, heading: float = 0.4) -> float:
    """Metres of translation, and the metres by which half a metre turns away."""
    between = found.T_world_object.localCoordinates(toy_state(heading).T_world_object)
    return float(np.linalg.norm(between[3:]) + 0.5 * np.linalg.norm(between[:3]))


# The loss by its definition: SDF by the decoder's values alone, derivatives by differences, the rest in numpy.


def canonical_sdf(state: ObjectState, p_world: np.ndarray) -> np.ndarray:
    """G(z, p) with p = exp(-s) R^T (p_world - t)."""
    T = state.T_world_object
    p = (p_world - T.translation()) @ T.rotation().matrix() / np.exp(state.log_scale)
    return DECODER(torch.as_tensor(p), torch.as_tensor(np.array(state.code))[None]).numpy()


def metres_at(state: ObjectState, p_world: np.ndarray) -> np.ndarray:
    """Metres per canonical unit: how much the SDF changes a metre, inverted."""
    step = 1e-6
    gradient = np.stack(
        [
            (canonical_sdf(state, p_world + step * axis) - canonical_sdf(state, p_world - step * axis))
            / (2 * step)
            for axis in np.eye(3)
        ],
        axis=1,
    )
    return 1 / np.linalg.norm(gradient, axis=1)


def energy(mu: np.ndarray, sigma: np.ndarray) -> np.ndarray:
    z = mu / sigma
    return sigma * (z * (2 * norm.cdf(z) - 1) + 2 * norm.pdf(z) - 1 / np.sqrt(np.pi))


def rule(renderer) -> tuple[np.ndarray, np.ndarray]:
    """Standard-normal nodes and weights."""
    if renderer == Probabilistic(moments="sobol"):
        u = torch.quasirandom.SobolEngine(1, scramble=True, seed=0).draw(128, dtype=torch.float64)[:, 0]
        return -norm.ppf(u.numpy()), np.full(128, 1 / 128)
    x = np.linspace(-8, 8, 401)
    return x, norm.pdf(x) / norm.pdf(x).sum()


def depths(renderer, sdf, sigma, rays: DrawnRays, slope: float) -> tuple[np.ndarray, np.ndarray]:
    """Mean and standard deviation of where each ray ends, sample by sample from the camera on."""
    x, weight = rule(renderer)
    uncertain = isinstance(renderer, Probabilistic)
    passed, mean, square = np.ones(len(sdf)), np.zeros(len(sdf)), np.zeros(len(sdf))
    depth, escape = rays.cells.depth.numpy(), 1.1 * rays.cells.far.numpy()
    origin = depth[:, 0]
    for k in range(sdf.shape[1]):
        s = sdf[:, k, None] + (sigma[:, k, None] * x if uncertain else 0.0 * x)
        occupied = expit(-slope * s) @ weight
        ends = passed * occupied
        mean += ends * (depth[:, k] - origin)
        square += ends * (depth[:, k] - origin) ** 2
        passed = passed * (1 - occupied)
    mean += passed * (escape - origin)
    square += passed * (escape - origin) ** 2
    variance = np.zeros(len(mean)) if renderer == Deterministic() else square - mean**2
    return mean + origin, np.sqrt(np.maximum(variance, 1e-12))


def depth_errors(renderer, sdf, sigma, rays: DrawnRays, slope: float) -> tuple[np.ndarray, np.ndarray]:
    """Rendered minus observed depth of the rays that say something (0 of the others), and its deviation."""
    mean, spread = depths(renderer, sdf, sigma, rays, slope)
    hit, far = rays.targets.hit.numpy(), rays.cells.far.numpy()
    target = np.where(hit, rays.targets.depth.numpy(), 1.1 * far)
    return np.where(hit | (rays.targets.end.numpy() >= far), mean - target, np.nan), spread


class Reference:
    """eq:final_loss of one object about a state, with its metres and its samples' place held."""

    def __init__(self, of: EstimationTask, config: AdamConfig, renderer, p_world, rays: DrawnRays) -> None:
        self.task, self.config, self.renderer, self.rays = of, config, renderer, rays
        self.state = of.starts[0]
        self.points = {"surface": p_world, "near": rays.p_near}
        self.metres = {name: metres_at(self.state, points) for name, points in self.points.items()}
        step = 1e-6
        self.jacobian = {
            name: np.stack(
                [
                    (self.sdf(name, step * axis) - self.sdf(name, -step * axis)) / (2 * step)
                    for axis in np.eye(DIM)
                ],
                axis=1,
            )
            for name in self.points
        }

    def sdf(self, name: str, delta: np.ndarray) -> np.ndarray:
        return self.metres[name] * canonical_sdf(self.state.retract(delta), self.points[name])

    def sigma(self, name: str, variance: np.ndarray) -> np.ndarray:
        """eq:sdf_variance; without uncertainty next to none."""
        if not self.config.uncertainty:
            return np.full(len(self.points[name]), 1e-6)
        return np.sqrt(np.square(self.jacobian[name]) @ variance)

    def along_rays(self, name: str, delta, variance) -> tuple[np.ndarray, np.ndarray]:
        """SDF and its deviation at all samples: what is not near stays as it was drawn, and certain."""
        near = self.rays.near.numpy()
        sdf, sigma = self.rays.sdf.numpy().copy(), np.zeros(near.shape)
        sdf[near], sigma[near] = self.sdf(name, delta), self.sigma(name, variance)
        return sdf, sigma

    def loss(self, delta: np.ndarray, variance: np.ndarray) -> float:
        config = self.config
        surface = energy(self.sdf("surface", delta), self.sigma("surface", variance))
        sdf, sigma = self.along_rays("near", delta, variance)
        error, spread = depth_errors(self.renderer, sdf, sigma, self.rays, config.steps.slope)
        counts = np.isfinite(error)
        code = self.state.retract(delta).code - self.task.prior.code_mean
        return (
            config.surface_weight * surface.mean()
            + config.render_weight * energy(error[counts], spread[counts]).sum() / self.rays.count
            + config.code_weight * np.mean(code**2)
        )

    def differences(self, function, at: np.ndarray, step: float = 1e-6) -> np.ndarray:
        return np.array(
            [(function(at + step * e) - function(at - step * e)) / (2 * step) for e in np.eye(DIM)]
        )


VARIANCE = np.array([1e-4] * 3 + [2e-4] * 3 + [5e-5] * 3 + [1e-3] * TOY_CODE)


def descent(config: AdamConfig, renderer, *tasks: EstimationTask) -> _Descent:
    """One whose variances differ from axis to axis."""
    found = _Descent(tasks, config, renderer)
    with torch.no_grad():
        found.log_variance.copy_(torch.as_tensor(VARIANCE).log().repeat(len(tasks), 1))
    return found


def drawn_at_start(found: _Descent) -> tuple[list[Pool], list[DrawnRays]]:
    pools = [
        pool.draw(rng, found.config.points, found.config.rays)
        for pool, rng in zip(found.pools, found.rngs, strict=True)
    ]
    return pools, draw_rays(found.decoder, found.states, pools, found.config.steps)


def loss_and_gradients(found: _Descent, pools, rays) -> tuple[float, np.ndarray, np.ndarray]:
    """Of the first object."""
    loss = float(found._gradients(pools, rays, 0)[0])
    assert found.delta.grad is not None
    assert not found.failures
    variance = torch.zeros_like(found.delta) if found.log_variance.grad is None else found.log_variance.grad
    return loss, found.delta.grad[0].numpy().copy(), variance[0].numpy().copy()


LOSSES = [
    (SMALL, Probabilistic()),
    (SMALL, Probabilistic(moments="sobol")),
    (SMALL, Sampled()),
    (SMALL, Deterministic()),
    (replace(SMALL, surface_weight=0.0, code_weight=0.0), Probabilistic()),
    (replace(SMALL, render_weight=0.0), Probabilistic()),
    (replace(SMALL, uncertainty=False), Deterministic()),
    (replace(SMALL, uncertainty=False, surface_weight=0.0), Sampled()),
]


@pytest.mark.parametrize(("config", "renderer"), LOSSES)
def test_loss_and_gradients_are_those_of_the_papers_loss(config, renderer):
    """eq:final_loss, moved through `retract` and through the logarithms of its variances."""
    one = task()
    found = descent(config, renderer, one)
    pools, rays = drawn_at_start(found)
    loss, d_state, d_variance = loss_and_gradients(found, pools, rays)
    reference = Reference(one, config, renderer, pools[0].p_world, rays[0])
    assert loss == pytest.approx(reference.loss(np.zeros(DIM), VARIANCE), rel=1e-5)
    expected = reference.differences(lambda delta: reference.loss(delta, VARIANCE), np.zeros(DIM))
    scale = np.abs(expected).max()
    assert scale > 0.1
    np.testing.assert_allclose(d_state, expected, atol=2e-4 * scale)
    if not config.uncertainty:
        assert (d_variance == 0).all()
        return
    expected = reference.differences(
        lambda log: reference.loss(np.zeros(DIM), np.exp(log)), np.log(VARIANCE), step=1e-4
    )
    assert np.abs(expected).min() > 0
    np.testing.assert_allclose(d_variance, expected, rtol=1e-3, atol=1e-4 * np.abs(expected).max())


@pytest.mark.parametrize("renderer", [Probabilistic(), Sampled(), Deterministic()])
@pytest.mark.parametrize("uncertainty", [True, False])
def test_single_precision_gives_the_same_gradients(renderer, uncertainty):
    config = replace(SMALL, uncertainty=uncertainty)
    double, single = (
        loss_and_gradients(found, *drawn_at_start(found))
        for found in (
            descent(config, renderer, task(decoder=decoder)) for decoder in (DECODER, ToyDecoder().float())
        )
    )
    assert single[0] == pytest.approx(double[0], rel=1e-4)
    for one, other in zip(single[1:], double[1:], strict=True):
        assert np.linalg.norm(one - other) <= 1e-3 * np.linalg.norm(other)


def test_linearized_points_are_those_of_single_objects(monkeypatch):
    """Decoded together and in pieces, each point is of its own object; one object may have none."""
    monkeypatch.setattr(terms, "CHUNK", 7)
    rng = np.random.default_rng(0)
    states = [toy_state(0.4).retract(OFF), toy_state(2.0, (0, 0.5, 0, 0)), toy_state(-1.0)]
    points = [
        state.to_world(rng.uniform(-0.5, 0.5, (n, 3))) for state, n in zip(states, (20, 0, 11), strict=True)
    ]
    together = linearize(DECODER, states, points)
    for state, p_world, found in zip(states, points, together, strict=True):
        query = query_points(DECODER, state, gtsam.Pose3(), p_world)
        jet = DECODER.linearize(query.p_object, query.code[None])
        metres = metres_per_unit(jet.d_point, state)
        torch.testing.assert_close(found.sdf, metres * jet.value)
        torch.testing.assert_close(found.jacobian, metres[:, None] * sdf_jacobian(query, jet, camera=False))
        assert found.jacobian.shape == (len(p_world), DIM)
        if len(p_world):
            held, step = metres_at(state, p_world), 1e-6
            np.testing.assert_allclose(found.sdf, held * canonical_sdf(state, p_world), rtol=1e-4, atol=1e-7)
            for axis, column in zip(np.eye(DIM), found.jacobian.numpy().T, strict=True):
                up, down = (canonical_sdf(state.retract(sign * step * axis), p_world) for sign in (1, -1))
                np.testing.assert_allclose(column, held * (up - down) / (2 * step), rtol=1e-3, atol=1e-5)


angles = st.floats(-3, 3)
offsets = st.floats(-1, 1)


@settings(max_examples=50)
@given(
    st.tuples(angles, angles, angles),
    st.tuples(offsets, offsets, offsets),
    st.tuples(*[st.floats(-0.5, 0.5)] * 3),
)
def test_rays_of_all_views_meet_the_box_where_each_views_do(turn, move, log_scale):
    state = ObjectState(
        gtsam.Pose3(gtsam.Rot3.Expmap(np.array(turn)), np.array(move)),
        np.array(log_scale),
        np.zeros(TOY_CODE),
    )
    pool = Pool.of(views())
    near, far = pool.rays.interval(state)
    start = 0
    for view in views():
        stop = start + len(view.rays.depth)
        expected = box_interval(state, view.T_world_camera, view.rays.directions_camera)
        np.testing.assert_allclose((near[start:stop], far[start:stop]), expected, rtol=1e-9, atol=1e-9)
        start = stop
    assert start == len(near)


def test_a_pool_holds_each_views_points_and_rays_in_the_world():
    pool = Pool.of(views())
    T = views()[1].T_world_camera
    first, count = len(views()[0].points_camera), len(views()[0].rays.depth)
    for p_world, p_camera in zip(pool.p_world[first:], views()[1].points_camera, strict=True):
        np.testing.assert_allclose(T.transformTo(p_world), p_camera, atol=1e-9)
    rays, some = views()[1].rays, pool.rays.take(np.arange(count, len(pool.rays.depth)))
    at = some.at(some.depth[:, None])[:, 0]
    for p_world, direction, depth in zip(at, rays.directions_camera, rays.depth, strict=True):
        np.testing.assert_allclose(T.transformTo(p_world), depth * direction, atol=1e-9)
    for name in ("depth", "hit", "end", "sigma"):
        np.testing.assert_array_equal(getattr(some, name), getattr(rays, name))


def test_a_draw_repeats_nothing_and_keeps_rays_whole():
    pool = Pool.of(views())
    drawn = pool.draw(np.random.default_rng(0), 50, 30)
    assert drawn.p_world.shape == (50, 3)
    assert len(np.unique(drawn.p_world, axis=0)) == 50
    for i, direction in enumerate(drawn.rays.direction_world):
        (index,) = np.flatnonzero((pool.rays.direction_world == direction).all(axis=1))
        for name, array in vars(drawn.rays).items():
            np.testing.assert_array_equal(array[i], getattr(pool.rays, name)[index])
    whole = pool.draw(np.random.default_rng(0), 10**6, 10**6)
    np.testing.assert_array_equal(np.sort(whole.rays.depth), np.sort(pool.rays.depth))
    np.testing.assert_array_equal(np.sort(whole.p_world, axis=0), np.sort(pool.p_world, axis=0))


def test_drawn_rays_step_through_the_box_and_leave_out_who_cannot_meet_it():
    state, steps = toy_state().retract(OFF), RaySteps(samples=20)
    pool = Pool.of(views())
    near, far = pool.rays.interval(state)
    aside = np.arange(len(near)) % 5 == 0  # every fifth ends before the box
    pool = Pool(pool.p_world, replace(pool.rays, end=np.where(aside, near - 0.01, pool.rays.end)))
    (drawn,) = draw_rays(DECODER, [state], [pool], steps)
    kept = np.flatnonzero((far > near + 1e-3) & ~aside & (pool.rays.end > near))
    assert drawn.count == len(near) > len(kept) > 0
    np.testing.assert_allclose(drawn.targets.depth, pool.rays.depth[kept])
    np.testing.assert_array_equal(drawn.targets.hit, pool.rays.hit[kept])
    np.testing.assert_allclose(drawn.cells.far, far[kept])
    edges = np.linspace(near[kept], far[kept], 21, axis=1)
    np.testing.assert_allclose(drawn.cells.depth, 0.5 * (edges[:, 1:] + edges[:, :-1]))
    np.testing.assert_allclose(drawn.cells.width, np.diff(edges, axis=1))
    p_world = pool.rays.take(kept).at(drawn.cells.depth.numpy())
    scale = np.exp(state.log_scale.mean())
    np.testing.assert_allclose(
        drawn.sdf.numpy().ravel(), scale * canonical_sdf(state, p_world.reshape(-1, 3)), atol=1e-9
    )
    np.testing.assert_array_equal(drawn.p_near, p_world[drawn.near.numpy()])
    assert 0.02 < drawn.near.double().mean() < 0.7


def with_all_samples(found: _Descent, pool: Pool, drawn: DrawnRays, near: np.ndarray) -> DrawnRays:
    """The same rays with other samples differentiated."""
    start, end = pool.rays.interval(found.states[0])
    kept = pool.rays.take(np.flatnonzero((end - start > 1e-3) & (pool.rays.end > start)))
    return replace(drawn, near=torch.as_tensor(near), p_near=kept.at(drawn.cells.depth.numpy())[near])


@pytest.mark.parametrize("renderer", [Probabilistic(), Sampled(), Deterministic()])
@pytest.mark.parametrize("heading", [0.4, 2.0])
@pytest.mark.parametrize("left_out", ["beyond reach", "all"])
def test_the_samples_left_out_would_change_nothing(renderer, heading, left_out):
    """The 2D term's gradient with more samples differentiated, at the paper's first variances."""
    config = replace(SMALL, rays=150, surface_weight=0.0, code_weight=0.0, steps=RaySteps())
    found = _Descent([task(heading)], config, renderer)
    (pool,), (few,) = drawn_at_start(found)
    _, *some = loss_and_gradients(found, [pool], [few])
    more = (
        np.abs(few.sdf.numpy()) < config.steps.band if left_out == "beyond reach" else np.ones(few.near.shape)
    )
    more = more.astype(bool)
    assert few.near.sum() < 0.9 * more.sum()
    _, *full = loss_and_gradients(found, [pool], [with_all_samples(found, pool, few, more)])
    for part, whole in zip(some, full, strict=True):
        assert np.linalg.norm(part - whole) <= 0.01 * np.linalg.norm(whole)


def result(of: EstimationTask, estimator) -> Estimate:
    (found,) = estimator.estimate([of])
    assert isinstance(found, Estimate)
    return found


@pytest.mark.parametrize(
    "estimator", [AdamEstimator(SMALL), AdamEstimator(replace(SMALL, monte_carlo=50)), GaussNewtonEstimator()]
)
def test_together_each_is_estimated_as_if_alone(estimator):
    if isinstance(estimator, GaussNewtonEstimator):
        estimator = GaussNewtonEstimator(GaussNewtonConfig(iterations=4, points=60, rays=40))
    other = ToyDecoder().double()
    tasks = [task(0.4), task(2.0, other), task(2.0)]
    together = estimator.estimate(tasks)
    for one, found in zip(tasks, together, strict=True):
        alone = result(one, estimator)
        assert isinstance(found, Estimate)
        assert np.abs(found.state.code - one.starts[0].code).max() > 1e-3
        np.testing.assert_allclose(found.state.matrix, alone.state.matrix, atol=1e-5)
        np.testing.assert_allclose(found.state.code, alone.state.code, atol=1e-5)
        assert found.cost_final == pytest.approx(alone.cost_final, rel=1e-5)
        if alone.covariance is not None:
            assert found.covariance is not None
            np.testing.assert_allclose(found.covariance.matrix, alone.covariance.matrix, rtol=1e-5)


def test_the_papers_estimate_of_the_score_tends_to_the_closed_form():
    closed = descent(replace(SMALL, render_weight=0.0), Probabilistic(), task())
    pools, rays = drawn_at_start(closed)
    expected = loss_and_gradients(closed, pools, rays)
    errors = []
    for samples in (100, 100_000):
        config = replace(SMALL, render_weight=0.0, monte_carlo=samples)
        found = loss_and_gradients(descent(config, Probabilistic(), task()), pools, rays)
        assert found[0] == pytest.approx(expected[0], rel=3 / np.sqrt(samples))
        pairs = zip(found[1:], expected[1:], strict=True)
        errors.append([np.linalg.norm(a - b) / np.linalg.norm(b) for a, b in pairs])
    assert max(errors[-1]) < 0.02
    assert (np.array(errors[0]) > np.array(errors[-1])).all()


def quick(name: str) -> Estimator:
    """A method with few points, rays and iterations."""
    estimator: Any = METHODS[name].estimator()
    if isinstance(estimator, AdamEstimator):
        config = replace(estimator.config, iterations=25, points=100, rays=80, steps=RaySteps(samples=30))
        return replace(estimator, config=config)
    if isinstance(estimator, GaussNewtonEstimator):
        return replace(estimator, config=replace(estimator.config, iterations=6, points=100, rays=80))
    inner = LevenbergMarquardtConfig(iterations=3)
    return replace(estimator, solver=SolverConfig(slopes=(60.0, 200.0), rounds=3, inner=inner))


@pytest.mark.parametrize("name", METHODS)
def test_every_method_comes_nearer(name):
    one, told = task(), []
    (found,) = quick(name).estimate([one], lambda done, total: told.append((done, total)))
    assert isinstance(found, Estimate)
    assert found.cost_final < 0.8 * found.cost_initial
    assert pose_error(found.state) < pose_error(one.starts[0])
    assert told
    assert told == sorted(told)
    assert told[-1][0] <= told[-1][1]
    assert found.linearizations > 0
    assert (found.covariance is None) == (name in ("dsp-slam", "dsp-slam-gn", "node-slam"))


def test_the_covariance_is_diagonal_labelled_and_learnt():
    found = result(task(), AdamEstimator(SMALL))
    assert found.covariance is not None
    assert found.covariance.source == "adam"
    assert len(found.covariance.axes) == DIM
    matrix = found.covariance.matrix
    assert matrix.shape == (DIM, DIM)
    np.testing.assert_array_equal(matrix, np.diag(np.diag(matrix)))
    start = np.array([SMALL.pose_variance] * RIGID_DOF + [SMALL.code_variance] * TOY_CODE)
    # Adam's first steps are as long as the learning rate, here of the logarithms
    moved = np.log(np.diag(matrix) / start)
    assert (np.abs(moved) > 0.5 * SMALL.learning_rate).all()
    assert (np.abs(moved) < 2 * SMALL.learning_rate * SMALL.iterations).all()
    assert found.linearizations == SMALL.iterations
    assert result(task(), AdamEstimator(replace(SMALL, uncertainty=False))).covariance is None


def test_the_first_step_is_as_long_as_the_learning_rate():
    """Adam's first step is its rate against the gradient's sign, taken along the tangent at the start."""
    one, config = task(), replace(SMALL, iterations=1)
    found = descent(config, Probabilistic(moments="sobol"), one)
    with torch.no_grad():
        found.log_variance.copy_(
            torch.tensor([1e-4] * RIGID_DOF + [1e-6] * TOY_CODE, dtype=torch.float64).log()
        )
    _, gradient, _ = loss_and_gradients(found, *drawn_at_start(found))
    expected = one.starts[0].retract(-config.learning_rate * np.sign(gradient))
    state = result(one, AdamEstimator(config)).state
    np.testing.assert_allclose(state.matrix, expected.matrix, atol=1e-6)
    np.testing.assert_allclose(state.code, expected.code, atol=1e-6)


class FragileDecoder(ToyDecoder):
    """Answers NaN to codes that ask for it, or to all once `broken` is set."""

    broken = False

    def _network(self, points, injected):
        lost = torch.full_like(points[:, 0], float(self.broken)) + (injected["0"][:, 0] > 50)
        return super()._network(points, injected) * torch.where(lost > 0, torch.nan, 1.0)


GAUSS_NEWTON = GaussNewtonEstimator(GaussNewtonConfig(iterations=4, points=60, rays=40))


def lost_code(decoder: FragileDecoder) -> EstimationTask:
    """The others' decoder fails on this object alone."""
    start = toy_state(1.0, (99.0, 0, 0, 0))
    return task(1.0, decoder, starts=(start,), views=views(), name="lost")


def broken_decoder(_: FragileDecoder) -> EstimationTask:
    decoder = FragileDecoder().double()
    decoder.broken = True
    return task(0.4, decoder, name="lost")


def nan_start(decoder: FragileDecoder) -> EstimationTask:
    state = toy_state()
    return task(0.4, decoder, starts=(replace(state, log_scale=np.full(3, np.nan)),), name="lost")


@pytest.mark.parametrize("estimator", [AdamEstimator(SMALL), GAUSS_NEWTON])
@pytest.mark.parametrize("bad", [lost_code, broken_decoder, nan_start])
def test_a_failing_object_fails_alone_and_by_name(estimator, bad):
    decoder = FragileDecoder().double()
    before, failed, after = estimator.estimate([task(0.4, decoder), bad(decoder), task(2.0, decoder)])
    assert isinstance(failed, SolveError)
    assert "lost" in str(failed)
    for found, heading in ((before, 0.4), (after, 2.0)):
        assert isinstance(found, Estimate)
        alone = result(task(heading, decoder), estimator)
        np.testing.assert_allclose(found.state.matrix, alone.state.matrix, atol=1e-9)
        assert np.isfinite(found.cost_final)


def test_an_object_that_no_ray_meets_is_still_drawn_by_its_points():
    start = toy_state()
    away = replace(start, T_world_object=start.T_world_object.retract(np.array([0, 0, 0, 0, 3.0, 0])))
    found = result(task(starts=(away,)), AdamEstimator(SMALL))
    assert found.cost_final < found.cost_initial


@pytest.mark.parametrize("estimator", [AdamEstimator(SMALL), GAUSS_NEWTON])
def test_the_same_seed_gives_the_same_result_and_another_another(estimator):
    one, two = (result(task(), estimator) for _ in range(2))
    np.testing.assert_array_equal(one.state.matrix, two.state.matrix)
    np.testing.assert_array_equal(one.state.code, two.state.code)
    assert (one.cost_initial, one.cost_final) == (two.cost_initial, two.cost_final)
    if one.covariance is not None:
        assert two.covariance is not None
        np.testing.assert_array_equal(one.covariance.matrix, two.covariance.matrix)
    other = result(task(), replace(estimator, config=replace(estimator.config, seed=1)))
    assert np.abs(other.state.matrix - one.state.matrix).max() > 1e-6


@pytest.mark.parametrize("estimator", [AdamEstimator(SMALL), GAUSS_NEWTON, quick("graph")])
@pytest.mark.parametrize(
    "lacking", [{"starts": ()}, {"views": ()}, {"starts": (replace(toy_state(), code=np.zeros(1)),)}]
)
def test_a_task_that_cannot_be_used_fails_alone(estimator, lacking):
    good, bad = task(), replace(task(), name="lacking", **lacking)
    failed, found = estimator.estimate([bad, good])
    assert isinstance(failed, SolveError)
    assert "lacking" in str(failed)
    assert isinstance(found, Estimate)


def test_gauss_newton_follows_the_gradient_of_half_its_squares():
    one, config = task(), replace(GAUSS_NEWTON.config, code_weight=2.0)
    pool = Pool.of(one.views).draw(np.random.default_rng(0), config.points, config.rays)
    (rays,) = draw_rays(DECODER, [one.starts[0]], [pool], config.steps)
    cost, H, gradient = GaussNewtonEstimator(config)._normal_equations(one, one.starts[0], pool, rays)
    reference = Reference(one, AdamConfig(uncertainty=False), Deterministic(), pool.p_world, rays)

    def residuals(delta):
        sdf, sigma = reference.along_rays("near", delta, VARIANCE)
        error, _ = depth_errors(Deterministic(), sdf, sigma, rays, config.steps.slope)
        code = reference.state.retract(delta).code - one.prior.code_mean
        return np.concatenate(
            [
                np.sqrt(config.surface_weight / config.points) * reference.sdf("surface", delta),
                np.sqrt(config.render_weight / config.rays) * np.nan_to_num(error),
                np.sqrt(config.code_weight) * code,
            ]
        )

    def half_square(delta):
        return 0.5 * np.sum(residuals(delta) ** 2)

    assert cost == pytest.approx(half_square(np.zeros(DIM)), rel=1e-6)
    expected = reference.differences(half_square, np.zeros(DIM))
    np.testing.assert_allclose(gradient, expected, atol=1e-4 * np.abs(expected).max())
    J = np.stack([(residuals(1e-6 * e) - residuals(-1e-6 * e)) / 2e-6 for e in np.eye(DIM)], axis=1)
    np.testing.assert_allclose(H, J.T @ J, atol=1e-3 * np.abs(H).max())
    # one full step, and the code's pull towards the prior's mean
    found = result(one, GaussNewtonEstimator(replace(config, iterations=1)))
    expected = one.starts[0].retract(-np.linalg.solve(H, gradient))
    np.testing.assert_allclose(found.state.matrix, expected.matrix, atol=1e-9)
    np.testing.assert_allclose(found.state.code, expected.code, atol=1e-9)


class DeafDecoder(ToyDecoder):
    """Its shape does not depend on its code."""

    def _network(self, points, injected):
        return super()._network(points, {"0": 0 * injected["0"]})


def test_a_singular_system_is_named():
    deaf = task(0.4, DeafDecoder().double(), name="deaf chair")
    (found,) = GaussNewtonEstimator(replace(GAUSS_NEWTON.config, code_weight=0.0)).estimate([deaf])
    assert isinstance(found, SolveError)
    assert "deaf chair" in str(found)
    assert isinstance(GAUSS_NEWTON.estimate([deaf])[0], Estimate)


def test_surface_and_rays_share_one_decoding():
    """What is linearised of points and rays together is what each would be by itself."""
    one = task()
    found = descent(SMALL, Probabilistic(), one)
    pools, rays = drawn_at_start(found)
    loss, d_state, d_variance = loss_and_gradients(found, pools, rays)
    surface, near = (linearize(DECODER, found.states, [p])[0] for p in (pools[0].p_world, rays[0].p_near))
    again = descent(SMALL, Probabilistic(), one)
    value = again._loss(0, Linearized(surface.sdf, surface.jacobian), near, rays[0], 0)
    gradients = torch.autograd.grad(value, [again.delta, again.log_variance])
    assert float(value) == pytest.approx(loss)
    np.testing.assert_allclose(gradients[0][0], d_state, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(gradients[1][0], d_variance, rtol=1e-9, atol=1e-12)
