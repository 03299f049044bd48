"""Which of several starts the graph comes from."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest

from factors.state import ObjectState
from objgraph.errors import SolveError
from objgraph.estimate.graph import GraphEstimator
from objgraph.estimate.task import Estimate
from objgraph.graph.solve import SolverConfig
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


def test_a_task_whose_starts_all_fail_fails_alone():
    tasks = [task(starts=(LOST, LOST), name="lost"), task(starts=(NEAR,))]
    lost, found = GraphEstimator(solver=QUICK).estimate(tasks)
    assert isinstance(lost, SolveError)
    assert str(lost).startswith("lost: ")
    assert isinstance(found, Estimate)
