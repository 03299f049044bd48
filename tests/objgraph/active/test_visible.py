"""Which points a camera has in its picture."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from objgraph.active.cameras import looking_at
from objgraph.active.next_view import NextViewConfig, next_views, visible
from objgraph.active.surface_sample import SurfaceSample
from objgraph.active.target import target
from objgraph.observation.frames import Intrinsics
from tests.objgraph.active.test_next_view import CONFIG, UP, scene_of, seen_once
from tests.toys import toy_prior

FEW = Intrinsics(8.0, 8.0, 3.5, 2.5, 8, 6)
"""A time-of-flight sensor's."""

CENTRE = np.array([0.0, 0.0, 0.4])
EYES = [CENTRE + 2.2 * np.array([np.cos(a), np.sin(a), 0.5]) for a in (0.3, 1.4, 2.6, 4.0)]


@given(*[st.integers(-16, 136).map(lambda sixteenths: sixteenths / 16)] * 2)
def test_a_point_is_seen_where_its_pixel_is_one_of_the_picture(u, v):
    """Pixel centres are whole numbers: the picture goes from half a pixel before the first to half a one behind the last."""
    p = FEW.backproject(np.array([u]), np.array([v]))
    wall = np.array([[-9.0, -9.0, 1.0], [9.0, -9.0, 1.0], [0.0, 9.0, 1.0]]), np.array([[0, 1, 2]])
    surface = SurfaceSample(p, np.array([[0.0, 0.0, -1.0]]), np.full(1, 0.01), *wall)
    (seen,) = visible(surface, gtsam.Pose3(), scene_of(wall), NextViewConfig(FEW))
    assert seen == (round(u) in range(8) and round(v) in range(6))


@pytest.mark.parametrize("place", [(1e4, -1e4, 0.0), (4e5, 5e5, 100.0), (9e5, -9e5, 0.0)])
def test_gains_are_the_same_wherever_the_world_begins(place):
    """In maps of surveyed coordinates too, where single precision has steps of centimetres."""
    state, covariance = seen_once()
    there = replace(
        state,
        T_world_object=gtsam.Pose3(
            state.T_world_object.rotation(), state.T_world_object.translation() + place
        ),
    )
    wall = np.array([[0.6, -3.0, 0.0], [0.6, 3.0, 0.0], [0.6, 0.0, 3.0]]), np.array([[0, 1, 2]])
    gains = []
    for here, moved in ((state, np.zeros(3)), (there, np.array(place))):
        chair = target(
            "chair 1", toy_prior(), here, covariance, resolution=48,
            seen_from=[looking_at(chair_eye + moved, CENTRE + moved, UP) for chair_eye in EYES[:1]],
        )  # fmt: skip
        cameras = [looking_at(eye + moved, CENTRE + moved, UP) for eye in EYES]
        found = next_views([chair], cameras, CONFIG, others=[(wall[0] + moved, wall[1])])
        for view in found:
            assert any(view.T_world_camera.equals(camera, 1e-6) for camera in cameras)
        found.sort(key=lambda view: tuple(np.round(view.T_world_camera.translation() - moved, 3)))
        gains.append([[*vars(view.objects["chair 1"]).values()] for view in found])
    assert np.ptp([gain[-1] for gain in gains[0]]) > 0.05
    np.testing.assert_allclose(gains[1], gains[0], rtol=0.02, atol=1e-6)
