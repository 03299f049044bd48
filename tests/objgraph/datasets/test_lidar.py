"""A LiDAR's point files: the same street as in KITTI's layout, every format, and what is damaged."""

import json

import numpy as np
import open3d as o3d
import pytest
import trimesh
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from objgraph.cli.main import main
from objgraph.cli.map import load_frame_of
from objgraph.cli.run_config import Source
from objgraph.datasets import kitti, load_lidar_frame
from objgraph.datasets.kitti_files import read_calibration, read_velodyne
from objgraph.datasets.lidar import frames
from objgraph.errors import DatasetError
from objgraph.synthetic.street import StreetConfig, ensure_street

FORMATS = ("bin", "pcd", "ascii.pcd", "compressed.pcd", "ply", "ascii.ply")


@pytest.fixture(scope="module")
def street(tmp_path_factory):
    return ensure_street(tmp_path_factory.mktemp("street"), StreetConfig(frames=1, cars=2))


@pytest.fixture
def folder(street, tmp_path):
    """The street's frame with points in binary."""
    folder = tmp_path / "corner"
    folder.mkdir()
    training = street / "training"
    T = read_calibration(training / "calib" / "000000.txt").T_rect_velodyne
    boxes = []
    for each in kitti.load_frame(street).detections:
        R, width_height_length = T[:3, :3].T @ each.T_world_object[:3, :3], each.size
        boxes.append(
            {
                "category": "car",
                "centre": (T[:3, :3].T @ (each.T_world_object[:3, 3] - T[:3, 3])).tolist(),
                "size": width_height_length[[2, 0, 1]].tolist(),
                "yaw": float(np.arctan2(-R[1, 2], -R[0, 2])),
                "score": each.score,
            }
        )
    (folder / "detections.json").write_text(json.dumps({"boxes": boxes}))
    (folder / "points.bin").write_bytes((training / "velodyne" / "000000.bin").read_bytes())
    return folder


def rewrite(folder, form):
    """The points in another format."""
    points = read_velodyne(folder / "points.bin")
    path = folder / f"points.{form.split('.')[-1]}"
    if form == "bin":
        return path
    (folder / "points.bin").unlink()
    if form.endswith("ply"):
        path.write_bytes(
            trimesh.PointCloud(points).export(
                file_type="ply", encoding="ascii" if "ascii" in form else "binary"
            )
        )
    else:
        cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
        o3d.io.write_point_cloud(
            str(path), cloud, write_ascii="ascii" in form, compressed="compressed" in form
        )
    return path


def test_detections_of_other_categories_stay_known(folder):
    """With --categories they are not mapped, and keep their returns."""
    path = folder / "detections.json"
    content = json.loads(path.read_text())
    content["boxes"][0]["category"] = "truck"
    path.write_text(json.dumps(content))
    frame = load_frame_of(Source("lidar", folder, categories=("car",)))
    assert [(each.id, each.category) for each in frame.detections] == [(2, "car")]
    assert [(each.id, each.category) for each in frame.others] == [(1, "truck")]


@pytest.mark.parametrize("form", FORMATS)
def test_the_frame_is_that_of_kittis_layout(folder, street, form):
    rewrite(folder, form)
    mine, theirs = load_lidar_frame("lidar", folder.parent, "corner"), kitti.load_frame(street)
    assert mine.name == "corner"
    np.testing.assert_allclose(mine.p_lidar, theirs.p_lidar, atol=1e-5)
    T = theirs.T_world_lidar @ np.linalg.inv(mine.T_world_lidar)  # from one world to the other
    np.testing.assert_allclose(T[:3, :3] @ mine.up_world, theirs.up_world, atol=1e-6)
    for a, b in zip(mine.detections, theirs.detections, strict=True):
        np.testing.assert_allclose(T @ a.T_world_object, b.T_world_object, atol=1e-5)
        np.testing.assert_allclose(a.size, b.size)
        assert (a.id, a.category, a.score) == (b.id, b.category, b.score)


def test_the_scan_is_the_root_or_a_folder_in_it(folder):
    assert frames(folder) == frames(folder.parent) == ["corner"]
    assert load_lidar_frame("lidar", folder).name == "corner"
    with pytest.raises(DatasetError, match="no scene 'bend'; available: corner"):
        load_lidar_frame("lidar", folder.parent, "bend")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda c: c.pop("boxes"), "has no list of boxes"),
        (lambda c: c["boxes"].append(3), r"box 3: must have category, centre, size and yaw"),
        (lambda c: c["boxes"][0].pop("yaw"), r"box 1: must have .*'yaw'"),
        (lambda c: c["boxes"][0].update(size=[1, 2]), "box 1: must have"),
        (lambda c: c["boxes"][1].update(size=[1, 2, 0]), "box 2: a box with edges"),
        (lambda c: c["boxes"][1].update(centre=[1, 2, float("nan")]), "box 2: must have .* finite numbers"),
        (lambda c: c["boxes"][0].update(category=" "), "box 1: has no category"),
    ],
)
def test_boxes_that_are_none_are_named(folder, change, message):
    content = json.loads((folder / "detections.json").read_text())
    change(content)
    (folder / "detections.json").write_text(json.dumps(content))
    with pytest.raises(DatasetError, match=message) as caught:
        load_lidar_frame("lidar", folder)
    assert str(folder / "detections.json") in str(caught.value)


def test_one_file_of_points_is_due(folder):
    (folder / "points.ply").write_bytes(b"")
    with pytest.raises(DatasetError, match=r"holds points\.ply, points\.bin; it must hold one of"):
        load_lidar_frame("lidar", folder)
    (folder / "points.ply").unlink()
    (folder / "points.bin").unlink()
    with pytest.raises(DatasetError, match=r"holds no points; it must hold one of"):
        load_lidar_frame("lidar", folder)


@pytest.mark.parametrize("form", ["bin", "ascii.pcd"])
def test_points_of_which_none_is_finite_are_named(folder, form):
    np.full((3, 4), np.nan, "<f4").tofile(folder / "points.bin")
    path = folder / "points.bin"
    if form != "bin":
        path.unlink()
        path = folder / "points.pcd"
        head = "FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nWIDTH 1\nHEIGHT 1\nPOINTS 1\nDATA ascii\n"
        path.write_text(f"{head}nan nan nan\n")
    with pytest.raises(DatasetError, match=f"{path}: no return is finite"):
        load_lidar_frame("lidar", folder)


@pytest.mark.parametrize("form", FORMATS)
@pytest.mark.parametrize("share", [0.0, 0.001, 0.5])
def test_truncated_points_are_named(folder, form, share):
    path = rewrite(folder, form)
    data = path.read_bytes()
    path.write_bytes(data[: int(share * len(data)) // 16 * 16 + 1])
    with pytest.raises(DatasetError) as caught:
        load_lidar_frame("lidar", folder)
    assert str(path) in str(caught.value)


@settings(max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.sampled_from(["a.pcd", "a.ply"]), st.integers(0, 250), st.binary(min_size=1, max_size=5))
def test_damaged_points_are_read_or_named(folder, form, place, junk):
    for path in folder.glob("points.*"):
        path.unlink()
    np.zeros((20, 4), "<f4").tofile(folder / "points.bin")
    path = rewrite(folder, form)
    data = path.read_bytes()
    path.write_bytes(data[:place] + junk + data[place + len(junk) :])
    try:
        named = load_lidar_frame("lidar", folder).name
    except DatasetError as error:
        named = str(error)
    assert "corner" in named


def test_a_car_is_mapped_by_the_command_near_its_label(folder, street, tmp_path):
    rewrite(folder, "pcd")
    content = json.loads((folder / "detections.json").read_text())
    (folder / "detections.json").write_text(json.dumps({"boxes": content["boxes"][:1]}))
    arguments = [
        "--mesh-resolution",
        "16",
        "--dataset",
        "lidar",
        "--root",
        str(folder.parent),
        "--scene",
        "corner",
    ]
    assert main(["map", "--out", str(tmp_path / "out"), *arguments]) == 0
    (entry,) = json.loads((tmp_path / "out" / "map.json").read_text())["objects"]
    assert entry["status"] == "mapped"
    T = read_calibration(street / "training" / "calib" / "000000.txt").T_rect_velodyne
    label = kitti.load_labels(street, "000000")[0]
    found = T[:3, :3] @ np.array(entry["T_world_object"])[:3, 3] + T[:3, 3]
    np.testing.assert_allclose(found, label.box.centre, atol=0.3)
    assert main(["report", str(tmp_path / "out")]) == 0
