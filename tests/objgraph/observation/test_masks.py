"""Which points are one object's."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from objgraph.observation.masks import of_one_object


@settings(max_examples=40, deadline=None)
@given(st.tuples(*[st.integers(-2000, 2000)] * 3), st.sampled_from([0.05, 0.25]), st.integers(2, 3))
def test_what_hangs_together_does_so_wherever_the_world_begins(moved, cell, apart):
    """Cells two apart are of one part, three apart of two."""
    rng = np.random.default_rng(0)
    block = np.stack(np.meshgrid(*[np.arange(3)] * 3), axis=-1).reshape(-1, 3)
    few = block[block[:, 0] == 0][:2] + [2 + apart, 0, 0]
    cells = np.repeat(np.concatenate([block, few]), 4, axis=0) + moved
    points = (cells + rng.uniform(0.1, 0.9, cells.shape)) * cell
    one = of_one_object(points, gap=0.0, cell=cell)
    assert one[: 4 * len(block)].all()
    assert (one[4 * len(block) :] == (apart == 2)).all()
