"""Trajectories in the TUM format: any change of a good one's."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from objgraph.datasets.trajectory import (
    Trajectory,
    absolute_trajectory_error,
    associate,
    interpolate,
    read_tum,
    write_tum,
)
from tests.fuzz.inputs import attempt, fuzzed
from tests.fuzz.strategies import damaged
from tests.objgraph.datasets.dataset_folders import pose

GOOD = Trajectory(np.arange(5) / 10, np.array([pose(k) for k in range(5)]))


@fuzzed
@given(data=st.data())
def test_a_trajectory_with_a_damaged_file(tmp_path_factory, data):
    path = tmp_path_factory.getbasetemp() / "trajectory.txt"
    write_tum(path, GOOD)
    content = data.draw(damaged(path))
    if content is None:
        path.unlink()
    else:
        path.write_bytes(content)

    def use():
        read = read_tum(path)
        assert np.isfinite(read.T_world_camera).all()
        associate(read.timestamps, GOOD.timestamps)
        interpolate(read, GOOD.timestamps, 0.1)
        absolute_trajectory_error(read, GOOD, "rigid")

    attempt(use)
