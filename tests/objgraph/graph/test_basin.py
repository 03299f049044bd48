"""From how far the solver comes back: starts that are off by up to 20 degrees, 20 cm and 20 %.

BASIN=100 tries so many starts and prints the share; without it a few.
"""

import os
from dataclasses import replace

import gtsam
import numpy as np

from factors.state import ObjectState
from objgraph.graph.builder import ObjectBuilder
from objgraph.graph.solve import SolverConfig, solve
from objgraph.observation.sampling import SamplingConfig, observe
from tests.objgraph.graph.graph_cases import UP, pose_error
from tests.toys import toy_frame, toy_prior, toy_state

STARTS = int(os.environ.get("BASIN", "5"))
DEGREES, METRES, SHARE = 20.0, 0.2, 0.2
"""Most that each axis of a start is off."""
SAMPLING = SamplingConfig(points=100, hits=60, free=60)
SAME = np.radians(3.0), 0.03
"""Radians and metres within which two solutions are one."""


def disturbed(state: ObjectState, rng: np.random.Generator) -> ObjectState:
    rotation, metres, share = (most * rng.uniform(-1, 1, 3) for most in (DEGREES, METRES, SHARE))
    T = state.T_world_object
    turned = gtsam.Pose3(
        T.rotation().compose(gtsam.Rot3.Expmap(np.radians(rotation))), T.translation() + metres
    )
    return replace(state, T_world_object=turned, log_scale=state.log_scale + np.log1p(share))


def test_starts_that_are_off_come_back_to_where_the_truth_does(capsys):
    truth, prior = toy_state(), toy_prior()
    views = [
        observe(toy_frame([truth], azimuth, str(i), seed=i), 1, SAMPLING)
        for i, azimuth in enumerate((0.3, 1.5, 2.6))
    ]
    builder, rng = ObjectBuilder(up_world=UP, floor=0.0), np.random.default_rng(0)
    reference = builder.alone(prior, truth, views)
    problems = [
        builder.alone(prior, disturbed(replace(truth, code=np.zeros(4)), rng), views) for _ in range(STARTS)
    ]
    solve([reference, *problems], SolverConfig(rounds=8))
    home = reference.state.T_world_object
    errors = [pose_error(problem.state.T_world_object, home) for problem in problems]
    back = sum(angle < SAME[0] and metres < SAME[1] for angle, metres in errors)
    with capsys.disabled():
        if "BASIN" in os.environ:
            print(f"\n{back} of {STARTS} starts came back")
    assert reference.failure is None
    assert pose_error(home, truth.T_world_object)[1] < 0.02
    assert back >= 0.95 * STARTS
