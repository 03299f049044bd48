"""The picture of a frame as it was understood: floor, up and masks are where they are."""

from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from objgraph.geometry.frames import transformed
from objgraph.observation.frames import Instance
from objgraph.show import doctor_picture as module
from objgraph.show.doctor_picture import doctor_picture
from tests.toys import toy_frame, toy_state

UP = np.array([0.0, 0.0, 1.0])
CHAIR = Instance(1, "chair")


@pytest.fixture(scope="module")
def frame():
    """A chair on the floor z = 0, without colours."""
    return toy_frame([toy_state()], 0.7)


def pixels(path):
    return np.asarray(Image.open(path).convert("RGB")).astype(int)


def test_dots_lie_on_the_floor_that_is_seen(frame):
    dots = module._dots(frame, UP, 0.0)
    assert len(dots) > 20
    u, v = np.round(dots).astype(int).T
    p_camera = frame.intrinsics.backproject(u, v) * frame.depth[v, u, None]
    assert np.median(np.abs(transformed(frame.T_world_camera, p_camera)[:, 2])) < 0.02
    assert not np.any(frame.instances[v, u] == 1)


def test_dots_below_what_is_seen_are_hidden(frame):
    assert len(module._dots(frame, UP, -1.0)) == 0


def test_the_arrow_points_up_and_names_stand_on_their_masks(frame):
    image = np.zeros((frame.intrinsics.height, frame.intrinsics.width, 3), np.uint8)
    begin = module._arrow(image, frame, UP, 1.0) - [0, 22]
    drawn = np.argwhere(image.any(axis=2))
    assert drawn[:, 0].min() < begin[1] - 20
    assert drawn[:, 0].max() < begin[1] + 10
    ((name, (u, v)),) = module._outline(image, frame, [CHAIR, Instance(9, "sofa")], 1.0).items()
    assert name == "chair 1"
    assert frame.instances[int(v), int(u)] == 1


def test_a_floor_tints_the_picture(frame, tmp_path):
    doctor_picture(frame, [CHAIR], UP, 0.0, tmp_path / "a" / "floor.png")
    doctor_picture(frame, [CHAIR], UP, None, tmp_path / "none.png")
    a, b = pixels(tmp_path / "a" / "floor.png"), pixels(tmp_path / "none.png")
    assert a.shape == b.shape
    bluer = (a[..., 2] - a[..., 0]) - (b[..., 2] - b[..., 0]) > 30
    assert 0.1 < bluer.mean() < 0.8


def test_a_frame_of_nothing_is_drawn(frame, tmp_path):
    empty = replace(
        frame, depth=np.zeros_like(frame.depth), instances=np.zeros_like(frame.instances), name="x"
    )
    doctor_picture(empty, [CHAIR], UP, 0.0, tmp_path / "x.png")
    assert pixels(tmp_path / "x.png").shape[1] > 900


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("none", [np.nan, np.inf, -1.0])
def test_no_depth_is_drawn_alike_however_it_is_written(frame, tmp_path, none):
    holes = np.random.default_rng(0).random(frame.depth.shape) < 0.6
    for name, value in (("zero", 0.0), ("none", none)):
        depth = np.where(holes | (frame.depth <= 0), value, frame.depth)
        doctor_picture(replace(frame, depth=depth), [CHAIR], UP, 0.0, tmp_path / f"{name}.png")
    np.testing.assert_array_equal(pixels(tmp_path / "none.png"), pixels(tmp_path / "zero.png"))
    assert len(np.unique(pixels(tmp_path / "none.png"))) > 100
