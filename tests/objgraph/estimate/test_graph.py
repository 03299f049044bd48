"""Which of several starts the graph comes from."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest

from factors.depth import DepthFactor
from factors.state import ObjectState
from factors.surface import SurfaceFactor
from objgraph.errors import SolveError
from objgraph.estimate.graph import GraphEstimator
from objgraph.estimate.task import Estimate
from objgraph.graph.solve import Problem, SolverConfig
from objgraph.priors.first_guess import FirstGuess, FirstGuessConfig
from tests.objgraph.estimate.adam_cases import OFF, pose_error, task
from tests.toys import toy_state

QUICK = SolverConfig(rounds=3)
NEAR = toy_state(0.4).retract(OFF)
BACK = replace(
    NEAR, T_world_object=NEAR.T_world_object.compose(gtsam.Pose3(gtsam.Rot3.Ry(np.pi), np.zeros(3)))
)
LOST = replace(NEAR, code=np.full_like(NEAR.code, np.nan))


@pytest.mark.parametrize("starts", [(NEAR, BACK), (BACK, NEAR), (LOST, BACK, NEAR)])
def test_the_cheapest_start_is_kept_wherever_it_stands(starts: tuple[ObjectState, ...]):
    (found,) = GraphEstimator(solver=QUICK).estimate([task(starts=starts)])
    assert isinstance(found, Estimate)
    assert pose_error(found.state) < 0.03


TINY = FirstGuessConfig(code_length=1, heading_width=4, place_width=4, hidden=4)


@pytest.mark.parametrize("chances", [(0.5, 0.5), ()])
def test_an_object_is_estimated_by_so_many_samples_of_all_its_views(chances):
    given = task(starts=(NEAR, BACK), chances=chances)
    points, rays = (
        sum(len(each) for each in several)
        for several in zip(*((view.points_camera, view.rays.depth) for view in given.views), strict=True)
    )
    seen: set[tuple[int, int]] = set()

    def watch(problem: Problem) -> None:
        (surface,) = (each for each in problem.factors if isinstance(each, SurfaceFactor))
        (depth,) = (each for each in problem.factors if type(each) is DepthFactor)
        seen.add((len(surface.points_camera()), len(depth._rays.depth)))

    few = GraphEstimator(solver=QUICK, samples=points // 3, heading_modes=None, watch=watch)
    (found,) = few.estimate([given])
    assert isinstance(found, Estimate)
    assert pose_error(found.state) < 0.03
    assert points // 3 < rays
    assert seen == {(points // 3, points // 3)}


def test_a_task_whose_starts_all_fail_fails_alone():
    tasks = [task(starts=(LOST, LOST), name="lost"), task(starts=(NEAR,))]
    lost, found = GraphEstimator(solver=QUICK).estimate(tasks)
    assert isinstance(lost, SolveError)
    assert str(lost).startswith("lost: ")
    assert isinstance(found, Estimate)


def test_a_view_that_makes_no_factor_fails_alone():
    good = task(starts=(NEAR,))
    points = good.views[0].points_camera.copy()
    points[0] = np.nan
    bad = replace(good, name="holed", views=(replace(good.views[0], points_camera=points),))
    holed, found = GraphEstimator(solver=QUICK).estimate([bad, good])
    assert isinstance(holed, SolveError)
    assert str(holed).startswith("holed: surface points has entries that are not finite")
    assert isinstance(found, Estimate)


def test_between_starts_that_cost_alike_the_first_guess_decides():
    """Twice the same start costs the same; and what a first guess holds for impossible is not taken though it is cheaper."""
    likely = task(starts=(NEAR, BACK), chances=(0.7, 0.3))
    unlikely = replace(likely, chances=(1e-300, 1.0))
    for given, right in ((likely, True), (unlikely, False)):
        (found,) = GraphEstimator(solver=QUICK).estimate([given])
        assert isinstance(found, Estimate)
        assert (pose_error(found.state) < 0.03) == right
        assert found.turns is not None
        assert found.turns.probability[0] == pytest.approx(1.0, abs=0.01)


@pytest.mark.parametrize("chances", [(1.0,), (0.5, 0.0), (0.5, float("nan"))])
def test_chances_that_do_not_fit_the_starts_fail_alone(chances: tuple[float, ...]):
    tasks = [task(starts=(NEAR, BACK), chances=chances, name="odd"), task(starts=(NEAR,))]
    odd, found = GraphEstimator(solver=QUICK).estimate(tasks)
    assert isinstance(odd, SolveError)
    assert str(odd).startswith("odd: of 2 starts")
    assert isinstance(found, Estimate)


def test_the_headings_of_a_first_guess_are_the_modes():
    """Their probabilities are those of costs and chances together, and no other turn is searched for."""
    given = task(starts=(NEAR, BACK), chances=(0.5, 0.5))
    (found,) = GraphEstimator(solver=QUICK).estimate([given])
    (again,) = GraphEstimator(solver=QUICK).estimate([replace(given, chances=(0.1, 0.9))])
    assert isinstance(found, Estimate)
    assert isinstance(again, Estimate)
    assert found.turns is not None
    assert again.turns is not None
    odds = [turns.probability[2] / turns.probability[0] for turns in (found.turns, again.turns)]
    assert odds[1] == pytest.approx(9 * odds[0], rel=1e-6)
    assert found.turns.states[0] is not None
    assert found.turns.states[2] is not None
    assert found.turns.states[1] is found.turns.states[3] is None
    (single,) = GraphEstimator(solver=QUICK, heading_modes=None).estimate([given])
    assert isinstance(single, Estimate)
    assert single.turns is None


def test_how_much_a_cost_says_beside_a_first_guess_is_the_guess_s_own():
    given = task(starts=(NEAR, BACK), chances=(0.5, 0.5))
    log_odds = []
    for temperature in (10.0, 40.0):
        guess = FirstGuess(replace(TINY, temperature=temperature))
        told = replace(given, prior=replace(given.prior, guess=guess))
        (found,) = GraphEstimator(solver=QUICK).estimate([told])
        assert isinstance(found, Estimate)
        assert found.turns is not None
        log_odds.append(np.log(found.turns.probability[0] / found.turns.probability[2]))
    assert log_odds[0] == pytest.approx(4 * log_odds[1], rel=1e-6)
    assert log_odds[1] > 0.1
