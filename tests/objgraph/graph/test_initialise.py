"""First guesses: boxes about gravity in any world, and the ranking that finds a chair's heading."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest
import torch

from factors.state import ObjectState
from objgraph.errors import InitialisationError
from objgraph.estimate.task import EstimationTask, unusable
from objgraph.graph import initialise
from objgraph.graph.builder import GraphConfig, ObjectBuilder
from objgraph.graph.initialise import (
    InitialisationConfig,
    first_states,
    guesses,
    rank,
)
from objgraph.graph.solve import Problem, SolverConfig
from objgraph.observation.sampling import ObjectView, SamplingConfig, observe
from objgraph.priors.first_guess import FirstGuess, FirstGuessConfig
from objgraph.priors.mesh import extract_mesh
from tests.objgraph.observation.test_gravity_box import cuboid, turned
from tests.toys import ToyDecoder, toy_frame, toy_prior, toy_state

UP = np.array([0.0, 0.0, 1.0])
SAMPLING = SamplingConfig(points=150, hits=80, free=80)


def view_of(points: np.ndarray) -> ObjectView:
    """A view that is nothing but its points."""
    view = observe(toy_frame([toy_state()], 0.3), 1, SAMPLING)
    return replace(
        view, T_world_camera=gtsam.Pose3(), points_camera=points, points_sigma=np.ones(len(points))
    )


@pytest.mark.parametrize("counts", [(), (9,), (4, 5)])
def test_too_few_points_are_an_error(counts):
    views = [view_of(np.ones((count, 3))) for count in counts]
    with pytest.raises(InitialisationError, match="too few to place an object"):
        guesses(toy_prior(), views, UP, None, InitialisationConfig())


@pytest.mark.parametrize("up", [(0, 0, 1), (0, -1, 0), (0.3, -0.8, 0.5)])
@pytest.mark.parametrize("floor", [None, -1.0])
def test_guesses_are_upright_evenly_turned_and_about_the_points(up, floor):
    up = np.array(up, float) / np.linalg.norm(up)
    points = turned(cuboid(), up, 0.4)
    config = InitialisationConfig(headings=6)
    states = guesses(toy_prior(), [view_of(points[:2000]), view_of(points[2000:])], up, floor, config)
    assert len(states) == 6
    turns = []
    for state in states:
        R = state.T_world_object.rotation()
        np.testing.assert_allclose(R.matrix()[:, 1], up, atol=1e-9)
        turns.append(gtsam.Rot3.Logmap(states[0].T_world_object.rotation().between(R))[1] % (2 * np.pi))
    # a turn of nothing may come out as a hair less than a whole one
    np.testing.assert_allclose(np.sort((np.array(turns) + 0.1) % (2 * np.pi)), 0.1 + np.arange(6) * np.pi / 3)
    low, high = -1.0 if floor == -1.0 else -0.65, 0.65
    for state in states:
        np.testing.assert_allclose(state.code, toy_prior().code_mean)
        centre = state.T_world_object.translation()
        assert centre @ up == pytest.approx(0.5 * (low + high), abs=0.03)
        np.testing.assert_allclose(centre - (centre @ up) * up, 0, atol=0.05)
        if floor is not None:  # then the height is the object's, and the mean shape is made as high
            height = state.scale[1] * toy_prior().start_extents[0, 1]
            assert height == pytest.approx(high - low, rel=0.2)


def test_a_guess_s_size_stays_in_the_category_s_range():
    prior = toy_prior()
    for factor in (0.01, 30.0):
        for state in guesses(prior, [view_of(cuboid() * factor)], UP, None, InitialisationConfig()):
            deviation = state.log_scale.mean() - np.log(prior.size_mean)
            assert abs(deviation) <= 2.5 * prior.size_log_sigma + 0.15 + 1e-9


def into(state: ObjectState, views, T: gtsam.Pose3) -> tuple[ObjectState, list[ObjectView]]:
    """The same scene told in another world."""
    moved = [replace(view, T_world_camera=T.compose(view.T_world_camera)) for view in views]
    return replace(state, T_world_object=T.compose(state.T_world_object)), moved


Y_DOWN = gtsam.Pose3(gtsam.Rot3.Rx(np.pi / 2), np.array([0.5, 0.2, -0.3]))
"""Takes a z-up world to one whose y points down."""


@pytest.mark.parametrize(
    ("heading", "T"),
    [(0.4, gtsam.Pose3()), (2.2, gtsam.Pose3()), (-1.3, Y_DOWN)],
    ids=["z up", "z up, turned", "y down"],
)
def test_ranking_keeps_the_chair_s_heading(heading, T):
    state = toy_state(heading)
    views = [observe(toy_frame([state], a, str(i), seed=i), 1, SAMPLING) for i, a in enumerate((0.3, 2.0))]
    state, views = into(state, views, T)
    up = T.rotation().matrix() @ UP
    floor = float(T.translation() @ up)
    config = InitialisationConfig()
    states = guesses(toy_prior(), views, up, floor, config)
    best, problems = rank(toy_prior(), views, states, ObjectBuilder(GraphConfig(), up, floor), config)
    assert len(problems) == len(states) == config.headings
    assert 1 <= len(best) <= config.keep
    errors = [
        np.linalg.norm(
            gtsam.Rot3.Logmap(state.T_world_object.rotation().between(b.T_world_object.rotation()))
        )
        for b in best
    ]
    assert errors[0] < np.radians(10)
    # the others are other headings, not the same one again
    assert all(error > 0.25 for error in errors[1:])


def test_ranking_is_cheapest_first_and_drops_what_cannot_be_solved():
    state = toy_state()
    views = [observe(toy_frame([state], 0.3), 1, SAMPLING)]
    lost = replace(state, code=np.full(4, np.nan))
    back = replace(
        state, T_world_object=state.T_world_object.compose(gtsam.Pose3(gtsam.Rot3.Ry(np.pi), np.zeros(3)))
    )
    best, _ = rank(
        toy_prior(), views, [lost, back, state], ObjectBuilder(up_world=UP), InitialisationConfig(keep=3)
    )
    turn = [
        gtsam.Rot3.Logmap(state.T_world_object.rotation().between(b.T_world_object.rotation())) for b in best
    ]
    assert np.linalg.norm(turn[0]) < 0.2
    assert len(best) <= 2
    with pytest.raises(InitialisationError, match=r"none of 2 guesses could be solved: .*o0"):
        rank(toy_prior(), views, [lost, lost], ObjectBuilder(up_world=UP), InitialisationConfig())


def test_a_shortlist_that_fails_says_why(monkeypatch):
    """Though the first guess, which was not on it, never did."""
    rounds = []

    def solve(problems: list[Problem], config: SolverConfig) -> None:
        rounds.append(config)
        for cost, problem in zip((2.0, 1.0), problems, strict=False):
            problem.cost = cost
            problem.failure = "o0 is lost" if len(rounds) == 2 else None

    monkeypatch.setattr(initialise, "solve", solve)
    views = [observe(toy_frame([toy_state()], 0.3), 1, SAMPLING)]
    config = InitialisationConfig(shortlist=1)
    with pytest.raises(InitialisationError, match=r"none of 2 guesses could be solved: o0 is lost"):
        rank(toy_prior(), views, [toy_state(), toy_state()], ObjectBuilder(up_world=UP), config)


def test_the_mean_shape_s_extents_are_the_prior_s():
    widths = 2 * np.array([0.26, 0.41, 0.26])
    wide = replace(toy_prior(), prototypes=np.array([[1.0, 0.0, 0.0, 0.0]]))
    np.testing.assert_allclose(wide.start_extents[0], widths, atol=0.03)
    assert wide.start_extents[1, 0] == pytest.approx(widths[0] + 0.1, abs=0.03)
    np.testing.assert_allclose(
        wide.start_extents[1], extract_mesh(wide.decoder, wide.starts[1], resolution=32).extents
    )


def test_starting_shapes_of_one_box_have_its_extents():
    """Whatever a coarse mesh of theirs lacks."""
    box = np.array([0.5, 0.7, 0.6])
    boxed = replace(toy_prior(), prototypes=np.array([[1.0, 0.0, 0.0, 0.0]]), box=box)
    np.testing.assert_array_equal(boxed.start_extents, [box, box])


def test_a_starting_shape_like_the_object_is_preferred():
    state = toy_state(code=(2.0, -2.0, 2.0, 0.0))
    views = [observe(toy_frame([state], a, str(i), seed=i), 1, SAMPLING) for i, a in enumerate((0.3, 2.0))]
    prior = replace(toy_prior(), prototypes=np.array([[-2.0, 2.0, -2.0, 0.0], [2.0, -2.0, 2.0, 0.0]]))
    states = guesses(prior, views, UP, 0.0, InitialisationConfig())
    assert len(states) == InitialisationConfig().guesses
    np.testing.assert_allclose(states[0].code, [2.0, -2.0, 2.0, 0.0])


def test_the_graph_of_one_object_has_its_views_and_priors():
    state = toy_state()
    view = observe(toy_frame([state], 0.3), 1, SAMPLING)
    for floor, rays_from_below in ((0.0, 1), (None, 0)):
        problem = ObjectBuilder(up_world=UP, floor=floor).alone(toy_prior(), state, [view, view])
        assert problem.graph.size() == 3 + 2 + rays_from_below
        assert len(problem.factors) == 2 + rays_from_below  # both views are in one of each kind
        assert all(isinstance(factor.decoder, ToyDecoder) for factor in problem.factors)


class Told(FirstGuess):
    """Says of the headings what it is told."""

    def __init__(self, log_probability: np.ndarray) -> None:
        super().__init__(FirstGuessConfig(code_length=4, heading_width=16, place_width=16, hidden=16))
        self.said = torch.from_numpy(log_probability).float()[None]

    def forward(self, points, size):
        return replace(super().forward(points, size), log_probability=self.said)


@pytest.mark.parametrize("least", [0.0, 0.03])
def test_a_first_guess_that_is_sure_is_taken(least):
    """Its probabilities are single precision's: those of one heading add up to a little more than one, others' are nothing."""
    sure = np.full(16, -300.0)
    sure[:2] = 0.0, -17.0
    view = observe(toy_frame([toy_state()], 0.3), 1, SAMPLING)
    prior = replace(toy_prior(), guess=Told(sure).requires_grad_(False))
    first = first_states(prior, [view], ObjectBuilder(up_world=UP), InitialisationConfig(least_chance=least))
    assert first.chances == (1.0,)
    task = EstimationTask("chair", prior, first.states, (view,), UP, chances=first.chances)
    assert unusable(task) is None
