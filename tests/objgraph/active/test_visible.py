"""Which points a camera has in its picture."""

import gtsam
import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from objgraph.active.next_view import NextViewConfig, visible
from objgraph.active.surface_sample import SurfaceSample
from objgraph.observation.frames import Intrinsics
from tests.objgraph.active.test_next_view import scene_of

FEW = Intrinsics(8.0, 8.0, 3.5, 2.5, 8, 6)
"""A time-of-flight sensor's."""


@given(*[st.integers(-16, 136).map(lambda sixteenths: sixteenths / 16)] * 2)
def test_a_point_is_seen_where_its_pixel_is_one_of_the_picture(u, v):
    """Pixel centres are whole numbers: the picture goes from half a pixel before the first to half a one behind the last."""
    p = FEW.backproject(np.array([u]), np.array([v]))
    wall = np.array([[-9.0, -9.0, 1.0], [9.0, -9.0, 1.0], [0.0, 9.0, 1.0]]), np.array([[0, 1, 2]])
    surface = SurfaceSample(p, np.array([[0.0, 0.0, -1.0]]), np.full(1, 0.01), *wall)
    (seen,) = visible(surface, gtsam.Pose3(), scene_of(wall), NextViewConfig(FEW))
    assert seen == (round(u) in range(8) and round(v) in range(6))
