"""The sample scene as files: layout, ground truth, determinism, atomicity."""

import json
from pathlib import Path

import cv2
import numpy as np
import open3d as o3d
import pytest

from objgraph.datasets import scannet
from objgraph.datasets.ground_truth import AnnotatedScan
from objgraph.errors import DatasetError
from objgraph.metrics.objects import evaluate_object
from objgraph.synthetic import sample as sample_module
from objgraph.synthetic.camera import CameraConfig
from objgraph.synthetic.sample import SampleConfig, ensure_sample, generate_sample
from objgraph.synthetic.scene import RoomConfig, furnish
from objgraph.synthetic.sensor import SensorConfig

SMALL = SampleConfig(seed=3, camera=CameraConfig(frames=3, width=80, height=60))
PERFECT = SensorConfig(
    axial_base_m=0,
    axial_growth=0,
    quantum=0,
    lateral_px=0,
    grazing_rad=(1.57, 1.58),
    edge_dropout=0,
    mask_px=0,
    range_m=(0, 20),
)


@pytest.fixture(scope="module")
def default_scan(tmp_path_factory) -> AnnotatedScan:
    root = generate_sample(tmp_path_factory.mktemp("default") / "sample")
    return scannet.load(root / "scannet")


@pytest.fixture(scope="module")
def perfect_root(tmp_path_factory) -> Path:
    config = SampleConfig(camera=CameraConfig(frames=6), sensor=PERFECT)
    return generate_sample(tmp_path_factory.mktemp("perfect") / "sample", config)


def files_of(root: Path) -> dict[str, bytes]:
    return {str(p.relative_to(root)): p.read_bytes() for p in sorted(root.rglob("*")) if p.is_file()}


def masked_points(scan: AnnotatedScan, instance: int) -> np.ndarray:
    points = []
    for frame in (scan.frames[i] for i in range(len(scan.frames))):
        v, u = np.nonzero((frame.instances == instance) & (frame.depth > 0))
        p_camera = frame.intrinsics.backproject(u, v) * frame.depth[v, u][:, None]
        points.append(p_camera @ frame.T_world_camera[:3, :3].T + frame.T_world_camera[:3, 3])
    return np.concatenate(points)


def distance_to_truth(scan: AnnotatedScan, instance: int) -> np.ndarray:
    truth = scan.ground_truth[instance]
    p_world = (truth.scale * truth.vertices) @ truth.T_world_object[:3, :3].T + truth.T_world_object[:3, 3]
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(
        o3d.core.Tensor(p_world.astype(np.float32)), o3d.core.Tensor(truth.faces.astype(np.uint32))
    )
    points = masked_points(scan, instance).astype(np.float32)
    return scene.compute_distance(o3d.core.Tensor(points)).numpy()


def test_the_loader_reads_the_scan_with_its_ground_truth(default_scan):
    categories = [instance.category for instance in default_scan.instances]
    assert sorted(categories) == ["chair"] * 4 + ["table"] * 2
    assert set(default_scan.ground_truth) == {instance.id for instance in default_scan.instances}
    assert len(default_scan.frames) == 28
    frame = default_scan.frames[0]
    assert frame.depth.shape == (240, 320)
    assert frame.color is not None
    for truth in default_scan.ground_truth.values():
        np.testing.assert_allclose(
            np.ptp(truth.vertices, axis=0) @ np.ptp(truth.vertices, axis=0), 1, atol=1e-4
        )
        result = evaluate_object(truth.T_world_object, truth.scale, truth.vertices, truth.faces, truth)
        assert result.pose_correct
        # upright, standing on the floor
        np.testing.assert_allclose(truth.T_world_object[:3, 1], [0, 0, 1], atol=1e-9)
        assert truth.T_world_object[2, 3] == pytest.approx(
            truth.scale[1] * np.ptp(truth.vertices[:, 1]) / 2, abs=1e-4
        )


def test_every_object_is_seen_and_some_are_cut(default_scan):
    frames = [default_scan.frames[i] for i in range(len(default_scan.frames))]
    pixels = np.array([np.bincount(frame.instances.ravel(), minlength=7)[1:7] for frame in frames])
    assert ((pixels > 375).sum(axis=0) >= 10).all()
    assert (pixels == 0).any()


def test_a_perfect_sensor_puts_every_masked_point_on_its_model(perfect_root):
    scan = scannet.load(perfect_root / "scannet")
    for instance in scan.instances:
        # depth is stored in millimetres, the models' vertices in millionths
        assert distance_to_truth(scan, instance.id).max() < 1.2e-3


def test_the_default_sensor_is_noisy_but_centred_on_the_models(default_scan):
    for instance in default_scan.instances:
        distance = distance_to_truth(default_scan, instance.id)
        assert 1e-3 < np.median(distance) < 0.015
        assert (distance > 0.1).mean() < 0.12  # masks that reach over the border


def test_ground_truth_is_that_of_the_furnished_room(perfect_root):
    config = SampleConfig()
    pieces = furnish(config.room, np.random.default_rng(config.seed).spawn(4)[0])
    scan = scannet.load(perfect_root / "scannet")
    for index, placed in enumerate(pieces):
        truth = scan.ground_truth[index + 1]
        np.testing.assert_allclose(truth.T_world_object, placed.T_world_object, atol=1e-9)
        np.testing.assert_allclose(truth.scale, placed.scale)
        np.testing.assert_allclose(truth.vertices, placed.piece.mesh.vertices, atol=1e-6)
        assert truth.symmetry == placed.piece.symmetry


def test_annotations_have_the_fields_of_scan2cad(perfect_root, shared_data):
    def fields(path: Path):
        entry = json.loads(path.read_text())[0]
        model = entry["aligned_models"][0]
        return set(entry), set(entry["trs"]), set(model), set(model["trs"])

    ours = fields(perfect_root / "scan2cad" / "full_annotations.json")
    theirs = fields(shared_data / "scan2cad" / "full_annotations.json")
    assert theirs[0] - {"id_alignment"} == ours[0]
    assert theirs[1:] == ours[1:]


def test_files_have_scannets_forms(tmp_path):
    root = generate_sample(tmp_path / "s", SMALL)
    scan = root / "scannet" / "scans" / SMALL.name
    depth = cv2.imread(str(scan / "depth" / "0.png"), cv2.IMREAD_UNCHANGED)
    masks = cv2.imread(str(scan / "instance-filt" / "0.png"), cv2.IMREAD_UNCHANGED)
    assert depth is not None
    assert masks is not None
    assert (depth.dtype, masks.dtype, depth.shape, masks.shape) == (np.uint16, np.uint8, (60, 80), (60, 80))
    assert 500 < np.median(depth[depth > 0]) < 6000  # millimetres
    K = np.loadtxt(scan / "intrinsic" / "intrinsic_depth.txt")
    np.testing.assert_allclose(K[:3, 2], [39.5, 29.5, 1])  # the middle, pixel centres at integers
    assert np.loadtxt(scan / "pose" / "2.txt").shape == (4, 4)
    assert f"numDepthFrames = {SMALL.camera.frames}\n" in (scan / f"{SMALL.name}.txt").read_text()


def test_equal_seeds_give_equal_bytes_and_others_do_not(tmp_path):
    first = files_of(generate_sample(tmp_path / "a", SMALL))
    again = files_of(generate_sample(tmp_path / "b", SMALL))
    assert first == again
    other = files_of(generate_sample(tmp_path / "c", SampleConfig(seed=4, camera=SMALL.camera)))
    assert first["scan2cad/full_annotations.json"] != other["scan2cad/full_annotations.json"]


def test_a_folder_in_use_is_refused_and_left_alone(tmp_path):
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.txt").write_text("years of work")
    with pytest.raises(DatasetError, match="already there"):
        generate_sample(tmp_path / "mine", SMALL)
    assert files_of(tmp_path) == {"mine/thesis.txt": b"years of work"}


def test_a_failure_leaves_nothing_behind(tmp_path, monkeypatch):
    def full_disk(*_):
        raise OSError("no space left on device")

    monkeypatch.setattr(sample_module, "write_ground_truth", full_disk)
    with pytest.raises(DatasetError, match="no space left"):
        generate_sample(tmp_path / "s", SMALL)
    assert list(tmp_path.iterdir()) == []


def test_a_room_too_small_is_a_typed_error(tmp_path):
    config = SampleConfig(room=RoomConfig(chairs=9, size_m=(2.0, 2.0)))
    with pytest.raises(DatasetError, match="no place for"):
        generate_sample(tmp_path / "s", config)
    assert list(tmp_path.iterdir()) == []


def test_the_cache_is_filled_once_and_kept_apart_by_configuration(tmp_path, monkeypatch):
    root = ensure_sample(tmp_path / "cache", SMALL)
    assert scannet.load(root / "scannet").name == SMALL.name
    other = SampleConfig(seed=5, camera=SMALL.camera)
    assert ensure_sample(tmp_path / "cache", other) != root
    monkeypatch.setattr(sample_module, "_write_sample", lambda *_: pytest.fail("it was there already"))
    assert ensure_sample(tmp_path / "cache", SMALL) == root


def test_a_process_that_comes_second_takes_the_firsts_sample(tmp_path, monkeypatch):
    def overtaken(building: Path, config: SampleConfig) -> None:
        monkeypatch.undo()
        ensure_sample(tmp_path, config)
        (building / "half").write_text("")

    monkeypatch.setattr(sample_module, "_write_sample", overtaken)
    root = ensure_sample(tmp_path, SMALL)
    assert (root / "sample.json").is_file()
    assert [path.name for path in tmp_path.iterdir()] == [root.name]
