"""What is wrong with a folder is found, named, and said how to mend; what is right is left alone."""

import shutil
from dataclasses import replace

import cv2
import gtsam
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from objgraph.datasets import load_scan
from objgraph.doctor import examine_scan
from objgraph.doctor.poses import examine_poses
from objgraph.doctor.seen import look
from objgraph.doctor.up import examine_up
from tests.objgraph.datasets.dataset_folders import frames_of, png
from tests.objgraph.doctor.doctor_cases import (
    FRAMES,
    change_images,
    change_poses,
    edit,
    examined,
    findings,
    moved,
    write_healthy_folder,
)

OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])


@pytest.fixture(scope="module")
def healthy(tmp_path_factory):
    return write_healthy_folder(tmp_path_factory.mktemp("doctor"))


@pytest.fixture
def folder(healthy, tmp_path):
    """A copy that a test may damage."""
    return shutil.copytree(healthy, tmp_path / "room")


@pytest.fixture(scope="module")
def scan(healthy):
    return load_scan("folder", healthy)


@pytest.fixture(scope="module")
def frames(scan):
    return frames_of(scan)


def the_finding(folder):
    """The one thing that is wrong."""
    (finding,) = findings(folder)
    return finding


def test_nothing_is_wrong_with_a_healthy_folder(healthy):
    found = examined(healthy)
    assert not [finding for section in found.sections for finding in section.findings]
    rows = {label: value for section in found.sections for label, value in section.rows}
    assert rows["frames"] == f"{FRAMES} of {FRAMES} can be read"
    assert rows["images"] == f"{FRAMES} of 160x120 pixels"
    assert rows["field of view"] == "58 x 45 degrees"
    assert rows["table 1"].startswith(f"prior table, in {FRAMES} of {FRAMES} frames")
    assert found.floor == pytest.approx(0.0, abs=0.02)


def test_the_frame_with_most_objects_is_the_one_to_draw(healthy):
    found = examined(healthy)
    assert found.scan is not None
    counts = [np.count_nonzero(np.unique(frame.instances)) for frame in frames_of(found.scan)]
    assert counts[found.best] == max(counts)


@pytest.mark.parametrize(
    ("dataset", "root", "scene", "stride"),
    [("scannet", "scannet", "scene0470_00", 3), ("icl", "icl_livingroom1", None, 6)]
    + [("sevenscenes", "sevenscenes", "redkitchen", 12)],
)
def test_nothing_is_wrong_with_real_scans(shared_data, dataset, root, scene, stride):
    found = examine_scan(dataset, shared_data / root, scene, stride=stride)
    assert not [finding for section in found.sections for finding in section.findings]


def test_depth_of_8_bits(folder):
    change_images(folder / "depth", lambda image: (image // 20).astype(np.uint8))
    finding = the_finding(folder)
    assert finding.where == f"{FRAMES} frames (0, 1, 2 and {FRAMES - 3} more)"
    assert "depth must be a 16-bit" in finding.what
    assert "write round(1000 * metres) as uint16" in finding.what


def test_metres_cast_to_integers(folder):
    change_images(folder / "depth", lambda image: (image // 1000).astype(np.uint16))
    first = findings(folder)[0]
    assert "metres cast to integers" in first.what
    assert "round(1000 * metres)" in first.do


def test_depth_in_another_unit(folder):
    edit(folder / "intrinsics.json", lambda c: c.update(depth_scale=1))
    unit = next(f for f in findings(folder) if f.where == "depth")
    assert "the median depth is 2.59e+03 m" in unit.what
    assert "depth_scale" in unit.do


@pytest.mark.parametrize("factor", [5.0, 0.1])
def test_depth_in_a_unit_that_a_room_may_have(folder, factor):
    edit(folder / "intrinsics.json", lambda c: c.update(depth_scale=1000 / factor))
    finding = the_finding(folder)
    assert f"another unit than depth, which is {factor:g} times what it should be" in finding.what
    assert f"divide depth by {factor:g} (`depth_scale`" in finding.do


def test_depth_that_is_twice_too_large_disagrees_with_the_poses(folder):
    edit(folder / "intrinsics.json", lambda c: c.update(depth_scale=500))
    assert any("poses and depth disagree" in finding.what for finding in findings(folder))


def test_frames_without_any_depth(folder):
    empty = np.zeros((120, 160), np.uint16)
    (folder / "depth" / "2.png").write_bytes(png(empty))
    (found,) = [f for f in findings(folder) if f.where == "frames"]
    assert found.what == f"1 of {FRAMES} frames have no depth: 2"
    change_images(folder / "depth", np.zeros_like)
    found = next(f for f in findings(folder) if f.where == "depth")
    assert found.what == "no frame has any"


def test_intrinsics_of_another_image_size(folder):
    def larger(camera):
        for key in ("fx", "fy", "cx", "cy"):
            camera[key] *= 2
        del camera["width"], camera["height"]

    edit(folder / "intrinsics.json", larger)
    finding = the_finding(folder)
    assert "intrinsics.json: the principal point" in finding.what
    assert "for another resolution; use the file that belongs to these images" in finding.what


@pytest.mark.parametrize("factor", [6.0, 0.05])
def test_a_field_of_view_that_no_camera_has(folder, factor):
    edit(folder / "intrinsics.json", lambda c: c.update(fx=factor * c["fx"], fy=factor * c["fy"]))
    found = next(f for f in findings(folder) if f.where == "intrinsics")
    assert "a field of view of" in found.what
    assert "the intrinsics of the camera that took these images" in found.do


def test_intrinsics_for_images_of_other_proportions(folder):
    edit(folder / "intrinsics.json", lambda c: c.update(fy=1.33 * c["fy"]))
    found = next(f for f in findings(folder) if f.where == "intrinsics")
    assert "for images of other proportions" in found.what


@pytest.mark.parametrize(
    ("change", "what", "do"),
    [
        (np.linalg.inv, "look inverted", "np.linalg.inv of each"),
        (lambda T: T @ OPENGL, "looks along its -z axis", r"diag(1, -1, -1, 1)"),
        (
            lambda T: np.linalg.inv(T @ OPENGL),
            "look view matrices",
            "np.linalg.inv of each matrix, times diag",
        ),
        (lambda T: T[[3, 0, 5, 6, 2, 7, 1, 4]], "poses and depth disagree", "each pose is its own image's"),
        (lambda T: np.array([w_first(each) for each in T]), "quaternions with w first", "as x y z w"),
    ],
)
def test_poses_in_another_convention(folder, change, what, do):
    change_poses(folder, change)
    (finding,) = [f for f in findings(folder) if f.where == "poses"]
    assert what in finding.what
    assert do in finding.do


def w_first(T: np.ndarray) -> np.ndarray:
    """A pose whose quaternion was written w x y z and read x y z w."""
    x, y, z, w = Rotation.from_matrix(T[:3, :3]).as_quat()
    return np.block([[Rotation.from_quat([w, x, y, z]).as_matrix(), T[:3, 3:]], [T[3:]]])


def test_poses_in_millimetres(folder):
    def millimetres(poses):
        poses[:, :3, 3] *= 1000
        return poses

    change_poses(folder, millimetres)
    (finding,) = [f for f in findings(folder) if f.where == "poses"]
    assert finding.do == "write their translations in metres"


def test_cameras_that_do_not_move(folder):
    change_poses(folder, lambda poses: np.repeat(poses[:1], len(poses), axis=0))
    finding = the_finding(folder)
    assert finding.what == f"all {FRAMES} poses are equal"


def test_what_follows_from_something_wrong_is_no_finding(folder):
    """Inverted poses turn the floor, too."""
    change_poses(folder, np.linalg.inv)
    found = examined(folder)
    assert the_finding(folder).where == "poses"
    assert ("not looked at", "until what is wrong is mended") in found.sections[-2].rows


def test_frames_that_share_nothing_are_a_note(folder):
    for kind in ("depth", "masks", "color"):
        for k in (1, 2, 3, 4, 5, 6):
            (folder / kind / f"{k}.png").unlink()
    first, last = "0", str(FRAMES - 1)
    for name, keep in ((first, np.s_[:, :40]), (last, np.s_[:, 120:])):

        def only(image, keep=keep):
            kept = np.zeros_like(image)
            kept[keep] = image[keep]
            return kept

        part = folder / name
        part.mkdir()
        shutil.move(folder / "depth" / f"{name}.png", part)
        change_images(part, only)
        shutil.move(part / f"{name}.png", folder / "depth")
    (poses,) = [s for s in examined(folder).sections if s.title == "Poses"]
    (finding,) = poses.findings
    assert finding.note
    assert "hardly any two frames see the same place" in finding.what


def test_frames_without_masks(folder):
    (folder / "masks" / "1.png").unlink()
    (folder / "masks" / "2.png").unlink()
    (finding,) = examined(folder).sections[0].findings
    assert finding.note  # to segment some of the frames is enough
    assert f"2 of {FRAMES} frames have no mask and are left out" in finding.what
    assert "write what is missing" in finding.do


def test_masks_without_frames(folder):
    shutil.copy(folder / "masks" / "1.png", folder / "masks" / "0001.png")
    finding = the_finding(folder)
    assert "1 masks have no depth image of their name: 0001; the frames are called 0, 1, 2" in finding.what
    assert finding.do == "name each mask as its depth image"


def test_ids_that_are_not_named(folder):
    edit(folder / "instances.json", lambda c: c["instances"].pop("2"))
    finding = the_finding(folder)
    assert "the masks have ids that are not named: 2 (in" in finding.what
    assert "name them in instances.json" in finding.do


def test_ids_that_are_another_object_s_in_the_next_frame(folder):
    for k in range(0, FRAMES, 2):
        mask = np.asarray(cv2.imread(str(folder / "masks" / f"{k}.png"), cv2.IMREAD_UNCHANGED), np.uint8)
        other = np.arange(256, dtype=mask.dtype)
        other[1:7] = 6, 5, 4, 3, 2, 1
        cv2.imwrite(str(folder / "masks" / f"{k}.png"), other[mask])
    finding = the_finding(folder)
    assert finding.what.startswith("what frames show of ")
    assert finding.what.endswith(" lies in places apart from each other")
    assert "the same id in all frames" in finding.do


def test_names_that_are_never_seen(folder):
    edit(folder / "instances.json", lambda c: c["instances"].update({"77": "chair"}))
    finding = the_finding(folder)
    assert (finding.where, finding.what) == ("chair 77", "is named, and no mask shows it")
    assert "the value 77" in finding.do


def test_masks_without_depth_behind_them(folder, frames):
    for frame in frames:
        depth = np.where(frame.instances == 3, 0, np.round(1000 * frame.depth)).astype(np.uint16)
        (folder / "depth" / f"{frame.name}.png").write_bytes(png(depth))
    finding = the_finding(folder)
    assert (finding.where, finding.what) == ("chair 3", "only 0% of its mask's pixels have depth")
    assert "masks and depth show the same view" in finding.do


def test_a_category_without_a_prior_is_a_note(folder):
    edit(folder / "instances.json", lambda c: c["instances"].update({"2": "Piano"}))
    assert findings(folder) == []
    (note,) = [finding for section in examined(folder).sections for finding in section.findings]
    assert note.note
    assert "no shape prior for Piano: a superquadric stands in" in note.what


def test_no_up(folder):
    edit(folder / "instances.json", lambda c: c.pop("up_world"))
    finding = the_finding(folder)
    assert "instances.json: 'up_world' is missing; it must read like" in finding.what


@pytest.mark.parametrize("up", [[0, 0, -1], [0, 1, 0], [0, -1, 0], [1, 0, 0], [-1, 0, 0]])
def test_another_axis_is_up(folder, up):
    edit(folder / "instances.json", lambda c: c.update(up_world=up))
    finding = the_finding(folder)
    assert finding.where == "up_world"
    assert "with [0, 0, 1] up they stand upright on a floor" in finding.what
    assert "[0, 0, 1], as it seems" in finding.do


def test_up_that_is_tilted(folder):
    edit(folder / "instances.json", lambda c: c.update(up_world=[0, 0.35, 1]))
    finding = the_finding(folder)
    assert "no floor is found" in finding.what


def test_objects_below_the_floor(scan):
    seen = look(scan)
    sunk = {i: points - [0, 0, 3.0] for i, points in seen.frames[0].points.items()}
    seen = replace(seen, frames=tuple(replace(frame, points=sunk) for frame in seen.frames))
    (finding,) = examine_up(seen)[0].findings
    assert "100% of the objects' points are below the floor" in finding.what


def test_a_truncated_image_is_named_and_the_others_are_read(folder):
    path = folder / "depth" / "3.png"
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    finding = the_finding(folder)
    assert finding.where == "frame 3"
    assert (
        f"{path}: no readable image (PNG or JPEG; truncated or damaged); download or export it again"
        in finding.what
    )
    rows = dict(examined(folder).sections[0].rows)
    assert rows["frames"] == f"{FRAMES - 1} of {FRAMES} can be read"


def test_what_the_loader_refuses_is_the_finding(tmp_path):
    finding = the_finding(tmp_path / "absent")
    assert "absent: no such folder" in finding.what
    (finding,) = [f for s in examine_scan("nope", tmp_path).sections for f in s.findings]
    assert "no data set 'nope'; available: " in finding.what


@st.composite
def worlds(draw):
    """T_new_world: any heading of up, anywhere near."""
    angles = [draw(st.floats(-3.1, 3.1)) for _ in range(3)]
    T = np.eye(4)
    T[:3, :3] = gtsam.Rot3.RzRyRx(*angles).matrix()
    T[:3, 3] = [draw(st.floats(-20, 20)) for _ in range(3)]
    return T


@settings(max_examples=15)
@given(T=worlds())
def test_where_the_world_begins_and_how_it_is_turned_does_not_matter(scan, frames, T):
    turned = replace(moved(scan, frames, lambda pose: T @ pose), up_world=T[:3, :3] @ scan.up_world)
    seen = look(turned)
    assert examine_poses(seen).findings == ()
    assert examine_up(seen)[0].findings == ()


@settings(max_examples=15)
@given(T=worlds())
def test_inverted_poses_are_known_in_every_world(scan, frames, T):
    (finding,) = examine_poses(look(moved(scan, frames, lambda pose: np.linalg.inv(T @ pose)))).findings
    assert "look inverted" in finding.what
