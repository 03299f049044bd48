"""States at the edge of what can be computed: a right answer, or a typed error that says what is wrong."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest
import torch

from factors.errors import FactorError
from factors.rays import Rays
from factors.state import ObjectState
from objgraph.covariance import ObjectCovariance, box_pose, fused, predicted_depth, surface_sigma
from objgraph.errors import CovarianceError, InitialisationError, MapError, ObjectGraphError, SolveError
from objgraph.graph.builder import GraphConfig, ObjectBuilder
from objgraph.graph.initialise import first_states
from objgraph.graph.single_object import ALONE, SingleObject
from objgraph.graph.solve import SolverConfig, solve
from objgraph.observation.sampling import ObjectView
from objgraph.priors.mesh import extract_mesh
from objgraph.priors.shape_prior import ShapePrior
from tests.factors.test_gradients_everywhere import check
from tests.objgraph.graph.graph_cases import UP, empty, views_of
from tests.objgraph.maps.map_cases import mapped
from tests.toys import TOY_CODE, RoundedToyDecoder, toy_prior, toy_state

STATE = toy_state()
VIEW = views_of(STATE)[0].thinned(40, 60)
PRIOR = replace(toy_prior(), decoder=RoundedToyDecoder().double())


def scaled(factor: float) -> tuple[ObjectState, ObjectView, ShapePrior]:
    """The toy chair, what is seen of it and what is known of chairs, as large as that."""

    def place(T: gtsam.Pose3) -> gtsam.Pose3:
        return gtsam.Pose3(T.rotation(), factor * T.translation())

    state = ObjectState(place(STATE.T_world_object), STATE.log_scale + np.log(factor), STATE.code)
    rays = VIEW.rays
    view = replace(
        VIEW,
        T_world_camera=place(VIEW.T_world_camera),
        points_camera=factor * VIEW.points_camera,
        points_sigma=factor * VIEW.points_sigma,
        rays=Rays(
            rays.directions_camera, factor * rays.depth, rays.hit, factor * rays.end, factor * rays.sigma
        ),
        correlation_length=max(1e-3, factor * VIEW.correlation_length),
    )
    return state, view, replace(PRIOR, size_mean=factor * PRIOR.size_mean)


def moved(state: ObjectState, T_world_object: gtsam.Pose3) -> ObjectState:
    return replace(state, T_world_object=T_world_object)


def inside() -> tuple[ObjectState, ObjectView, ShapePrior]:
    """The camera is in the middle of the object."""
    T = STATE.T_world_object
    return moved(STATE, gtsam.Pose3(T.rotation(), VIEW.T_world_camera.translation())), VIEW, PRIOR


def behind() -> tuple[ObjectState, ObjectView, ShapePrior]:
    """The object is as far behind the camera as it should be before it."""
    T, camera = STATE.T_world_object, VIEW.T_world_camera.translation()
    return moved(STATE, gtsam.Pose3(T.rotation(), 2 * camera - T.translation())), VIEW, PRIOR


def one_point() -> tuple[ObjectState, ObjectView, ShapePrior]:
    """One point and one ray are seen."""
    return STATE, VIEW.thinned(1, 1), PRIOR


CASES = {
    "a millimetre": lambda: scaled(1e-3),
    "a kilometre": lambda: scaled(1e3),
    "the camera inside": inside,
    "behind the camera": behind,
    "one point": one_point,
}


def single(case: str) -> SingleObject:
    state, view, prior = CASES[case]()
    floor = None if case in ("the camera inside", "behind the camera") else 0.0
    return ObjectBuilder(GraphConfig(surface_tail=None), up_world=UP, floor=floor).alone(prior, state, [view])


@pytest.mark.parametrize("case", CASES)
def test_every_factor_has_a_finite_cost_and_its_gradient(case):
    problem, rng = single(case), np.random.default_rng(0)
    for factor in problem.factors:
        factor.refresh(problem.values)
        graph = gtsam.NonlinearFactorGraph()
        graph.push_back(factor.gtsam_factor())
        assert np.isfinite(graph.error(problem.values))
        check(graph, problem.values, rng, step=1e-9 if case == "a millimetre" else 1e-6)


@pytest.mark.parametrize("case", CASES)
def test_it_is_solved_to_no_more_cost_and_has_a_covariance(case):
    problem = single(case)
    solve([problem], SolverConfig(slopes=(60.0, 400.0), rounds=3))
    assert problem.failure is None
    assert problem.cost <= problem.cost_initial
    state = problem.state
    assert np.isfinite(state.local_coordinates(STATE)).all()
    marginals = problem.marginals()
    assert np.linalg.eigvalsh(marginals.matrix).min() > 0
    assert (problem.covariance(400.0).sigma >= marginals.sigma - 1e-12).all()


def test_the_chair_of_a_kilometre_is_known_as_well_as_one_of_a_metre():
    """All lengths a thousand times larger: angles, scales and code are as sure as they were; its slope is another."""
    sigmas = []
    for factor in (1.0, 1e3):
        state, view, prior = scaled(factor)
        problem = ObjectBuilder(GraphConfig(surface_tail=None), up_world=UP).alone(prior, state, [view])
        problem.refresh(400.0 / factor)
        sigma = problem.marginals().sigma.copy()
        sigma[3:6] /= factor
        sigmas.append(sigma)
    np.testing.assert_allclose(sigmas[1], sigmas[0], rtol=0.02)


def test_no_rays_and_no_points_are_refused():
    with pytest.raises(FactorError, match="at least one is due"):
        VIEW.rays.take(np.zeros(0, int))
    with pytest.raises(FactorError, match="at least one is due"):
        ObjectBuilder().view(PRIOR, ALONE, VIEW.thinned(0, 5), VIEW.T_world_camera)


@pytest.mark.parametrize("log_scale", [800.0, -800.0, np.nan])
def test_a_start_of_no_size_is_refused_and_nothing_is_added(log_scale):
    objects = empty()
    with pytest.raises(FactorError, match="s0, the log-scale"):
        objects.add_object(PRIOR, replace(STATE, log_scale=np.full(3, log_scale)))
    assert objects.values.size() == objects.graph.size() == 0


class BrokenDecoder(RoundedToyDecoder):
    """Answers NaN, everywhere or for codes that have gone too far."""

    def __init__(self, beyond: float = -np.inf) -> None:
        super().__init__()
        self.beyond = beyond

    def _network(self, points, injected):
        value = super()._network(points, injected)
        return torch.where(injected["0"][:, 0] > self.beyond, torch.full_like(value, torch.nan), value)


BROKEN = replace(PRIOR, decoder=BrokenDecoder())
COVARIANCE = ObjectCovariance.of(1e-4 * np.eye(9 + TOY_CODE), "marginals")
EDGES = np.array([[x, y, z] for x in (-0.3, 0.3) for y in (-0.3, 0.3) for z in (-0.3, 0.3)])


@pytest.mark.parametrize(
    ("ask", "error"),
    [
        (lambda: extract_mesh(BROKEN.decoder, STATE.code), SolveError),
        (lambda: surface_sigma(BROKEN.decoder, STATE, COVARIANCE, EDGES), SolveError),
        (
            lambda: predicted_depth(
                BROKEN.decoder, STATE, COVARIANCE, VIEW.T_world_camera, VIEW.rays.directions_camera
            ),
            SolveError,
        ),
        (lambda: box_pose(BROKEN, STATE, COVARIANCE, EDGES), SolveError),
        (lambda: first_states(BROKEN, [VIEW], ObjectBuilder(up_world=UP)), InitialisationError),
    ],
)
def test_a_decoder_that_gives_no_number_is_a_typed_error(ask, error):
    with pytest.raises(error):
        ask()


def test_a_decoder_that_gives_no_number_fails_the_object_by_name_and_moves_nothing():
    objects = empty()
    handle = objects.add_object(BROKEN, STATE, name="the blue chair")
    objects.observe(handle, VIEW)
    with pytest.raises(SolveError, match=r"the blue chair: .*not finite"):
        objects.optimize()
    assert objects.state(handle).T_world_object.equals(STATE.T_world_object, 0)
    with pytest.raises(ObjectGraphError, match="not finite"):
        objects.marginals(handle)


def test_a_step_to_where_the_decoder_gives_no_number_is_shortened():
    prior = replace(PRIOR, decoder=BrokenDecoder(0.62))
    start = replace(STATE, code=STATE.code - 0.3)
    problem = ObjectBuilder(up_world=UP).alone(prior, start, [VIEW])
    solve([problem], SolverConfig(slopes=(60.0, 400.0), rounds=3))
    assert problem.failure is None
    assert problem.cost < problem.cost_initial
    assert problem.state.code[0] <= 0.62


def indefinite() -> np.ndarray:
    """Symmetric, variances of one, and two axes that go along more than they vary."""
    matrix = np.eye(9 + TOY_CODE)
    matrix[3, 7] = matrix[7, 3] = 1.2
    return matrix


def test_an_indefinite_covariance_is_refused():
    with pytest.raises(CovarianceError, match="indefinite"):
        ObjectCovariance.of(indefinite(), "marginals")
    with pytest.raises(MapError, match=r"joint_covariance is none: .*indefinite"):
        replace(mapped(1), joint_covariance=_joint(mapped(1)))


def _joint(entry) -> np.ndarray:
    joint = np.array(entry.joint_covariance)
    joint[3, 15] = joint[15, 3] = 2 * np.sqrt(joint[3, 3] * joint[15, 15])
    return joint


def test_a_covariance_without_an_inverse_is_not_fused():
    flat = ObjectCovariance.of(np.diag([0.0, *np.ones(8 + TOY_CODE)]), "marginals")
    with pytest.raises(CovarianceError, match="second estimate's covariance is not positive definite"):
        fused((STATE, COVARIANCE), (STATE, flat))
