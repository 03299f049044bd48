"""Cubes by one integer."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.testing import assert_array_equal

from objgraph.geometry.voxels import voxel_indices, voxel_keys

POINTS = arrays(float, st.tuples(st.integers(1, 30), st.just(3)), elements=st.floats(-3000, 3000))


@given(POINTS, st.sampled_from([0.01, 0.05, 1.0]))
def test_keys_are_the_rows_of_indices_in_their_order(points: np.ndarray, edge: float) -> None:
    indices = np.floor(points / edge).astype(int)
    rows, inverse, counts = np.unique(indices, axis=0, return_inverse=True, return_counts=True)
    keys, same, as_many = np.unique(voxel_keys(points, edge), return_inverse=True, return_counts=True)
    assert_array_equal(voxel_indices(keys), rows)
    assert_array_equal(same, inverse.ravel())
    assert_array_equal(as_many, counts)


def test_far_from_the_origin_as_many_cubes_are_told_apart() -> None:
    """Metres of a national grid, 600 km off: whole multiples of the edge away, so that the cubes are the same."""
    points = np.random.default_rng(0).uniform(0, 2, (500, 3))
    far = points + 0.0625 * np.array([9_600_000, -3_200_000, 160])
    _, here = np.unique(voxel_keys(points, 0.0625), return_inverse=True)
    _, there = np.unique(voxel_keys(far, 0.0625), return_inverse=True)
    pairs = set(zip(here.tolist(), there.tolist(), strict=True))
    assert len(pairs) == len(set(here)) == len(set(there))
