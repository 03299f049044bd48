"""View selection: the stated rule on made-up frames, its properties, and its choice on the real scan."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from objgraph.datasets import load_scan
from objgraph.errors import ObservationError
from objgraph.observation.frames import Frame, FrameSource, Intrinsics
from objgraph.observation.view_selection import InstanceView, ViewIndex, ViewSelectionConfig, summarize

CAMERA = Intrinsics(60, 60, 31.5, 23.5, 64, 48)


class Frames(FrameSource):
    """Frames in a list, counting how often they are read."""

    def __init__(self, frames):
        self.frames, self.reads = frames, 0

    def __len__(self):
        return len(self.frames)

    def __getitem__(self, index):
        self.reads += 1
        return self.frames[index]


def _pose(azimuth, distance=2.0):
    """A camera that looks at the world's origin from an angle about the world's y axis."""
    T_world_camera = np.eye(4)
    cosine, sine = np.cos(azimuth), np.sin(azimuth)
    T_world_camera[:3, :3] = [[cosine, 0, sine], [0, 1, 0], [-sine, 0, cosine]]
    T_world_camera[:3, 3] = T_world_camera[:3, :3] @ [0, 0, -distance]
    return T_world_camera


def _frame(columns=slice(20, 44), azimuth=0.0, rows=slice(10, 38), instance=1, depth=2.0):
    """A mask of these columns and rows on a plane across the viewing direction."""
    instances = np.zeros((48, 64), dtype=int)
    instances[rows, columns] = instance
    return Frame("f", np.full((48, 64), depth), CAMERA, _pose(azimuth), instances)


def _view(frame, pixels=2000.0, cut=0.0, voxels=(1,), angle=0.0):
    direction = np.array([np.cos(angle), np.sin(angle), 0])
    return InstanceView(frame, pixels, cut, np.array(sorted(voxels)), direction)


def _select(views, count, config=None):
    return ViewIndex({1: views}, config or ViewSelectionConfig()).select(1, count)


def test_what_a_frame_sees_is_summarised():
    frame = _frame(azimuth=0.5)
    frame.depth[10:20] = 0
    frame.depth[20, 20:24] = [np.nan, np.inf, 9.0, -1]
    index = summarize(Frames([frame]))
    (view,) = index.views[1]
    assert view.pixels == (18 * 24 - 4) * 100  # the image has a hundredth of 640x480's pixels
    assert view.cut == 0
    np.testing.assert_allclose(view.direction_world, [-np.sin(0.5), 0, -np.cos(0.5)], atol=0.1)
    # 24 x 18 pixels of 2 / 60 metres each, about one 3 cm voxel a pixel and never two
    assert 300 < len(view.voxels) <= 18 * 24 - 4


@pytest.mark.parametrize(("columns", "cut"), [(slice(0, 28), 1.0), (slice(1, 29), 0.5), (slice(2, 30), 0.0)])
def test_a_cut_is_measured_in_the_masks_own_width(columns, cut):
    (view,) = summarize(Frames([_frame(columns)])).views[1]  # 28 rows and 28 columns
    assert view.cut == pytest.approx(cut)


def test_pixels_scale_with_the_images_area():
    small = _frame()
    camera = Intrinsics(120, 120, 63.5, 47.5, 128, 96)
    repeat = np.ones((2, 2), dtype=int)
    large = Frame("f", np.kron(small.depth, repeat), camera, _pose(0), np.kron(small.instances, repeat))
    (a,), (b,) = (summarize(Frames([frame])).views[1] for frame in (small, large))
    assert a.pixels == b.pixels


def test_the_first_view_is_the_largest_uncut_one():
    assert _select([_view(0, 2000), _view(1, 5000), _view(2, 4000)], 1) == [1]
    assert _select([_view(0, 2000), _view(1, 5000, cut=1.0), _view(2, 4000)], 1) == [2]
    assert _select([_view(0, 2000), _view(1, 5000, cut=0.2), _view(2, 4000)], 1) == [1]


def test_further_views_bring_new_surface():
    views = [
        _view(0, 5000, voxels=range(10)),
        _view(1, 4000, voxels=range(12)),
        _view(2, voxels=range(5, 25)),
    ]
    assert _select(views, 2) == [0, 2]


def test_equal_surface_goes_to_the_other_direction():
    first = _view(0, 5000, voxels=range(10))
    near, far = _view(1, voxels=range(10, 20), angle=0.1), _view(2, voxels=range(20, 30), angle=1.5)
    assert _select([first, near, far], 2) == [0, 2]
    assert _select([first, near, far], 3) == [0, 2, 1]


def test_beyond_the_full_angle_directions_count_alike():
    first = _view(0, 5000, voxels=range(10))
    side, back = _view(1, voxels=range(10, 21), angle=1.2), _view(2, voxels=range(30, 40), angle=3.0)
    assert _select([first, side, back], 2) == [0, 1]


def test_what_the_border_cuts_counts_less():
    first = _view(0, 5000, voxels=range(10))
    cut, whole = _view(1, cut=1.0, voxels=range(10, 22)), _view(2, voxels=range(30, 40))
    assert _select([first, cut, whole], 2) == [0, 2]


def test_small_masks_count_only_where_there_is_nothing_better():
    small, large = _view(0, 1400, voxels=range(100)), _view(1, 1600, voxels=range(5))
    assert _select([small, large], 2) == [1]
    assert _select([small, _view(1, 900, voxels=range(200))], 2) == [0, 1]


def test_a_view_without_new_surface_is_never_chosen():
    assert _select([_view(0, 5000, voxels=range(10)), _view(1, voxels=range(5), angle=2.0)], 5) == [0]


@settings(deadline=None, max_examples=50)
@given(
    st.lists(
        st.tuples(
            st.floats(1, 1e5), st.floats(0, 1), st.sets(st.integers(0, 30), min_size=1), st.floats(-3, 3)
        ),
        min_size=1,
        max_size=8,
    ),
    st.integers(1, 10),
)
def test_selection_is_without_repetition_and_grows(rows, count):
    views = [_view(k, *row) for k, row in enumerate(rows)]
    chosen = _select(views, count)
    assert 1 <= len(chosen) <= count
    assert len(set(chosen)) == len(chosen)
    assert _select(views, count + 1)[: len(chosen)] == chosen


def test_frames_are_read_once_for_all_instances():
    first, second = _frame(instance=1), _frame(instance=2, azimuth=1.0)
    frames, seen = Frames([first, second]), []
    index = summarize(frames, progress=lambda done, total: seen.append((done, total)))
    assert (index.select(1, 3), index.select(2, 3)) == ([0], [1])
    assert frames.reads == 2
    assert seen == [(1, 2), (2, 2)]


def test_an_instance_that_no_frame_sees_is_named():
    blind = _frame(instance=3, depth=0.0)
    frames = Frames([_frame(), blind])
    for instance_id in (3, 4):
        with pytest.raises(ObservationError, match=f"instance {instance_id}: no frame"):
            summarize(frames).select(instance_id, 2)
    with pytest.raises(ObservationError, match="0 views"):
        summarize(frames).select(1, 0)
    with pytest.raises(ObservationError, match="no frame"):
        summarize(Frames([])).select(1, 1)


def test_millimetres_are_told_of():
    """They are all beyond any depth that counts: that there are no pixels is then not what is wrong."""
    index = summarize(Frames([_frame(depth=2000.0)]))
    with pytest.raises(
        ObservationError, match=r"instance 1: no frame .* metres; millimetres: divide by 1000"
    ):
        index.select(1, 3)


def test_views_of_the_real_scan_see_more_than_the_largest_masks(shared_data):
    scan = load_scan("scannet", shared_data / "scannet")
    index = summarize(scan.frames)
    for instance in scan.instances:
        views = {view.frame: view for view in index.views[instance.id]}
        chosen = index.select(instance.id, 3)
        assert len(chosen) == 3
        assert views[chosen[0]].cut < 0.2
        largest = sorted(views, key=lambda frame: -views[frame].pixels)[:3]
        surface, plain = (
            len(set(np.concatenate([views[frame].voxels for frame in some]))) for some in (chosen, largest)
        )
        assert surface >= plain
