"""The benchmark's cases: fixed by the seed, seen as a person would see them, and of any folder of meshes."""

import dataclasses
import logging
import pickle
import subprocess
import sys
from pathlib import Path

import numpy as np
import open3d as o3d
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from objgraph.bench.pictures.worlds import draw_families, draw_views
from objgraph.bench.worlds.cases import SIZES, BenchmarkConfig, Case, synthetic_cases
from objgraph.bench.worlds.families import FAMILIES
from objgraph.bench.worlds.viewpoints import APART, DISTANCE_M, HEIGHT_M
from objgraph.datasets.ground_truth import AnnotatedScan, GroundTruth
from objgraph.errors import DatasetError, PriorError
from objgraph.maps.pipeline import scene_floor
from objgraph.metrics.objects import evaluate_object
from objgraph.observation.sampling import observe
from objgraph.synthetic.sensor import SensorConfig

SEED = 1000
PAIRS = [(0, 1), (0, 2), (1, 2)]


@pytest.fixture(scope="module")
def seen() -> list[tuple[Case, AnnotatedScan]]:
    """Cases of every family."""
    return [(case, case.scan()) for case in synthetic_cases(BenchmarkConfig(seed=SEED, objects=8))]


def digest(scan: AnnotatedScan) -> bytes:
    frames = [scan.frames[i] for i in range(len(scan.frames))]
    images = [image.tobytes() for f in frames for image in (f.depth, f.instances, f.T_world_camera)]
    truth = scan.ground_truth[1]
    return b"".join(
        [*images, truth.T_world_object.tobytes(), truth.scale.tobytes(), truth.vertices.tobytes()]
    )


def p_world(truth: GroundTruth) -> np.ndarray:
    return (truth.scale * truth.vertices) @ truth.T_world_object[:3, :3].T + truth.T_world_object[:3, 3]


def model_of(truth: GroundTruth) -> o3d.t.geometry.RaycastingScene:
    scene = o3d.t.geometry.RaycastingScene(nthreads=1)
    scene.add_triangles(p_world(truth).astype(np.float32), np.asarray(truth.faces, np.uint32))
    return scene


def apart(scan: AnnotatedScan) -> list[float]:
    """Degrees between the views' bearings about the target."""
    middle = scan.ground_truth[1].T_world_object[:2, 3]
    away = [scan.frames[i].T_world_camera[:2, 3] - middle for i in range(3)]
    bearings = [complex(*a) for a in away]
    return [abs(np.degrees(np.angle(bearings[i] / bearings[j]))) for i, j in PAIRS]


def test_a_smaller_size_is_the_beginning_of_a_larger_one():
    lists = {
        size: synthetic_cases(dataclasses.replace(BenchmarkConfig(seed=SEED), size=size)) for size in SIZES
    }
    for size, cases in lists.items():
        assert len(cases) == 2 * SIZES[size]
        assert len({case.id for case in cases}) == len({case.shape for case in cases}) == len(cases)
    for category in ("chair", "table"):
        small, standard, full = ([c for c in lists[s] if c.category == category] for s in SIZES)
        assert small == standard[:6]
        assert standard == full[:24]


@settings(max_examples=50)
@given(st.integers(1, 40), st.integers(1, 40), st.integers(0, 10**12), st.sampled_from(["wide", "close"]))
def test_families_are_used_evenly_and_counts_are_prefixes(few, more, seed, spacing):
    few, more = sorted((few, more))
    config = BenchmarkConfig(seed=seed, objects=more, categories=("table",), spacing=spacing)
    cases = synthetic_cases(config)
    assert cases[:few] == synthetic_cases(dataclasses.replace(config, objects=few))
    families = [case.shape.rsplit("-", 2)[0] for case in cases]
    counts = [families.count(family) for family in FAMILIES["table"]]
    assert max(counts) - min(counts) <= 1
    assert sum(counts) == more


def test_ids_say_what_differs():
    base = BenchmarkConfig(seed=SEED, objects=2)
    others = [
        dataclasses.replace(base, seed=1001),
        dataclasses.replace(base, spacing="close"),
        dataclasses.replace(base, sensor=SensorConfig(mask_px=1.5)),
    ]
    ids = [case.id for config in (base, *others) for case in synthetic_cases(config)]
    assert len(set(ids)) == len(ids)
    assert "close" in synthetic_cases(others[1])[0].id


def test_equal_cases_give_equal_scans_in_every_process():
    case = synthetic_cases(BenchmarkConfig(seed=SEED, objects=2))[1]
    first = digest(case.scan())
    assert digest(case.scan()) == first
    assert digest(pickle.loads(pickle.dumps(case)).scan()) == first
    code = (
        "import sys; from objgraph.bench.worlds.cases import BenchmarkConfig, synthetic_cases;"
        f"scan = synthetic_cases(BenchmarkConfig(seed={SEED}, objects=2))[1].scan();"
        "sys.stdout.buffer.write(b''.join(scan.frames[i].depth.tobytes() for i in range(3)))"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, check=True)
    assert run.stdout == b"".join(case.scan().frames[i].depth.tobytes() for i in range(3))
    other = synthetic_cases(BenchmarkConfig(seed=SEED + 1, objects=2))[1]
    assert digest(other.scan()) != first


def test_views_are_apart_and_held_by_a_person(seen):
    for _, scan in seen:
        low, high = APART["wide"]
        assert all(low - 1e-6 <= angle <= high + 1e-6 for angle in apart(scan))
        truth = scan.ground_truth[1]
        floor = p_world(truth)[:, 2].min()
        for i in range(3):
            T = scan.frames[i].T_world_camera
            np.testing.assert_allclose(T[:3, :3].T @ T[:3, :3], np.eye(3), atol=1e-9)
            assert np.linalg.det(T[:3, :3]) > 0
            assert T[2, 1] < -0.5  # the image's down is the world's
            assert HEIGHT_M[0] - 1e-6 <= T[2, 3] - floor <= HEIGHT_M[1] + 1e-6
            distance = np.linalg.norm(T[:3, 3] - truth.T_world_object[:3, 3])
            assert DISTANCE_M[0] - 1e-6 <= distance <= DISTANCE_M[1] + 1e-6


def silhouette(scan: AnnotatedScan, index: int) -> np.ndarray:
    """Pixels at which the target would be seen if nothing stood before it."""
    frame, truth = scan.frames[index], scan.ground_truth[1]
    v, u = np.mgrid[: frame.intrinsics.height, : frame.intrinsics.width]
    rays = frame.intrinsics.backproject(u, v) @ frame.T_world_camera[:3, :3].T
    eye = np.broadcast_to(frame.T_world_camera[:3, 3], rays.shape)
    cast = model_of(truth).cast_rays(o3d.core.Tensor(np.concatenate([eye, rays], -1).astype(np.float32)))
    return np.isfinite(cast["t_hit"].numpy())


def test_every_view_shows_enough_of_the_target_and_some_are_occluded(seen):
    hidden = []
    for case, scan in seen:
        for i in case.views(3):
            frame = scan.frames[i]
            mask, whole = frame.instances == case.instance.id, silhouette(scan, i)
            assert (mask & (frame.depth > 0)).sum() * 4 >= 1500
            assert (mask & whole).sum() / whole.sum() > 1 / 3
            assert (mask & ~whole).sum() < 0.25 * mask.sum()
            assert len(observe(frame, case.instance.id).points_camera) == 300
            hidden.append(1 - (mask & whole).sum() / whole.sum())
    worst = np.reshape(hidden, (-1, 3)).max(axis=1)
    assert 0.25 < (worst > 0.15).mean() < 0.95


def test_masked_points_lie_on_the_ground_truth(seen):
    for case, scan in seen[::3]:
        truth = scan.ground_truth[1]
        frame = scan.frames[0]
        v, u = np.nonzero((frame.instances == case.instance.id) & (frame.depth > 0))
        some = np.random.default_rng(0).permutation(len(v))[:2000]
        p_camera = frame.intrinsics.backproject(u[some], v[some]) * frame.depth[v[some], u[some], None]
        points = p_camera @ frame.T_world_camera[:3, :3].T + frame.T_world_camera[:3, 3]
        distance = model_of(truth).compute_distance(points.astype(np.float32)).numpy()
        assert np.median(distance) < 0.015
        assert (distance < 0.1).mean() > 0.75


def test_the_ground_truth_is_one_upright_object_of_a_real_size(seen):
    for case, scan in seen:
        assert list(scan.ground_truth) == [case.instance.id]
        assert scan.instances == (case.instance,)
        truth = scan.ground_truth[1]
        np.testing.assert_allclose(truth.T_world_object[:3, 1], scan.up_world, atol=1e-9)
        assert np.linalg.norm(np.ptp(truth.vertices, axis=0)) == pytest.approx(1)
        height = truth.scale[1] * np.ptp(truth.vertices[:, 1])
        assert (0.67 < height < 1.27) if case.category == "chair" else (0.36 < height < 0.87)
        result = evaluate_object(truth.T_world_object, truth.scale, truth.vertices, truth.faces, truth)
        assert result.pose_correct


def test_the_floor_is_found_from_the_frames(seen):
    for _, scan in seen:
        floor = scene_floor(scan)
        assert floor == pytest.approx(p_world(scan.ground_truth[1])[:, 2].min(), abs=0.02)
        assert floor is not None
        assert abs(floor) > 1e-3  # the world's origin gives nothing away


def test_close_and_wide_share_room_and_first_view(seen):
    close = synthetic_cases(BenchmarkConfig(seed=SEED, objects=8, spacing="close"))
    for case, (wide, scan) in list(zip(close, seen, strict=True))[::3]:
        near = case.scan()
        assert case.shape == wide.shape
        low, high = APART["close"]
        assert all(low - 1e-6 <= angle <= high + 1e-6 for angle in apart(near))
        for name in ("depth", "instances", "color", "T_world_camera"):
            np.testing.assert_array_equal(getattr(near.frames[0], name), getattr(scan.frames[0], name))
        assert (near.frames[1].depth != scan.frames[1].depth).any()
        np.testing.assert_array_equal(near.ground_truth[1].scale, scan.ground_truth[1].scale)


def test_views_are_counted_from_one_to_three():
    case = synthetic_cases(BenchmarkConfig(seed=SEED, objects=1))[0]
    assert [case.views(n) for n in (1, 2, 3)] == [(0,), (0, 1), (0, 1, 2)]
    for count in (0, 4):
        with pytest.raises(DatasetError, match="1 to 3"):
            case.views(count)


@pytest.fixture
def mesh_folder(tmp_path) -> Path:
    for category, extents in (("chair", (0.5, 0.9, 0.5)), ("table", (1.2, 0.7, 0.8))):
        (tmp_path / category / "deep").mkdir(parents=True)
        for i in range(3):
            size = np.array(extents) * [1 + 0.1 * i, 1, 1]
            trimesh.creation.box(extents=size).export(tmp_path / category / "deep" / f"{i}.ply")
    return tmp_path


def test_meshes_of_a_folder_are_shuffled_and_cycled(mesh_folder, caplog):
    config = BenchmarkConfig(seed=SEED, objects=7, meshes=mesh_folder)
    cases = synthetic_cases(config)
    chairs = [case.shape for case in cases if case.category == "chair"]
    assert sorted(chairs[:3]) == [f"chair/deep/{i}.ply" for i in range(3)]
    assert chairs[3:] == (chairs[:3] * 2)[:4]
    assert len({case.id for case in cases}) == 14
    assert mesh_folder.name in cases[0].id
    assert synthetic_cases(dataclasses.replace(config, objects=2))[0] == cases[0]
    orders = {synthetic_cases(dataclasses.replace(config, seed=s))[0].shape for s in range(1000, 1020)}
    assert len(orders) > 1

    (mesh_folder / "chair" / "torn.obj").write_text("no mesh")
    with caplog.at_level(logging.WARNING):
        assert [c.shape for c in synthetic_cases(config) if c.category == "chair"].count(
            "chair/torn.obj"
        ) == 0
    assert "torn.obj" in caplog.text


def test_a_meshs_case_has_its_shape_at_a_real_size(mesh_folder):
    config = BenchmarkConfig(seed=SEED, objects=2, categories=("table",), meshes=mesh_folder)
    files = []
    for case in synthetic_cases(config):
        scan = case.scan()
        truth = scan.ground_truth[1]
        assert case.mesh is not None
        files.append(case.mesh.path)
        file = trimesh.load_mesh(case.mesh.path)
        np.testing.assert_allclose(
            np.ptp(truth.vertices, axis=0), file.extents / np.linalg.norm(file.extents), atol=1e-5
        )
        assert truth.symmetry == 2
        assert 0.4 < np.ptp(p_world(truth)[:, 2]) < 0.85
    files[-1].unlink()
    with pytest.raises(PriorError, match=files[-1].name):
        case.scan()


def test_other_categories_are_of_a_folder_and_as_large_as_usual(tmp_path):
    (tmp_path / "sofa").mkdir()
    trimesh.creation.box((2.0, 0.8, 0.9)).export(tmp_path / "sofa" / "plain.ply")
    config = BenchmarkConfig(seed=SEED, objects=3, categories=("sofa",), meshes=tmp_path)
    cases = synthetic_cases(config)
    assert [case.category for case in cases] == ["sofa"] * 3
    sizes = [
        float(np.linalg.norm(case.world().truth.scale * np.ptp(case.world().truth.vertices, axis=0)))
        for case in cases
    ]
    assert len({round(size, 3) for size in sizes}) == 3
    assert all(1.2 < size < 4.0 for size in sizes)
    with pytest.raises(DatasetError, match="of category 'sofa' give a folder of meshes"):
        synthetic_cases(dataclasses.replace(config, meshes=None))


def test_a_folder_without_meshes_is_named(mesh_folder):
    with pytest.raises(DatasetError, match="bench/chair"):
        synthetic_cases(BenchmarkConfig(meshes=mesh_folder / "bench"))
    for path in (mesh_folder / "table").rglob("*.ply"):
        path.unlink()
    with pytest.raises(DatasetError, match="table: none of its 0"):
        synthetic_cases(BenchmarkConfig(meshes=mesh_folder))


def test_requests_that_make_no_sense_are_refused():
    with pytest.raises(DatasetError, match="'sofa'"):
        synthetic_cases(BenchmarkConfig(categories=("chair", "sofa")))
    with pytest.raises(DatasetError, match="at least one"):
        synthetic_cases(BenchmarkConfig(objects=0))
    assert len(synthetic_cases(BenchmarkConfig(categories=("chair", "chair"), objects=3))) == 3


def test_a_mesh_that_no_camera_can_see_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr("objgraph.bench.worlds.viewpoints._ROOMS", 2)
    (tmp_path / "chair").mkdir()
    thread = trimesh.creation.box(extents=(1e-4, 1.0, 1e-4))
    thread.export(tmp_path / "chair" / "thread.ply")
    case = synthetic_cases(BenchmarkConfig(objects=1, categories=("chair",), meshes=tmp_path))[0]
    with pytest.raises(DatasetError, match="thread chair"):
        case.scan()


def test_pictures_are_drawn(tmp_path):
    draw_families(tmp_path / "families.png", SEED)
    draw_views(tmp_path / "views.png", SEED, objects=1)
    assert {path.name for path in tmp_path.iterdir()} == {"families.png", "views.png"}
