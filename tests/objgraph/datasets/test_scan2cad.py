"""Scan2CAD's annotations: decomposition, matching to instances, and the fit to the real scan."""

import json
import logging

import numpy as np
import pytest
import trimesh
import trimesh.sample
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation
from trimesh.exchange.obj import export_obj

from objgraph.datasets import ground_truth as truth_of
from objgraph.datasets import load_scan
from objgraph.datasets.scan2cad import load_aligned_models, match_models
from objgraph.errors import DatasetError
from tests.objgraph.datasets.dataset_folders import write_bytes

CHAIR, TABLE = "03001627", "04379243"


def _trs(seed, scale=(1.0, 1.0, 1.0)):
    rng = np.random.default_rng(seed)
    rotation = Rotation.random(rng=rng).as_quat(scalar_first=True)
    return {"translation": rng.normal(size=3).tolist(), "rotation": rotation.tolist(), "scale": list(scale)}


def _matrix(trs):
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_quat(trs["rotation"], scalar_first=True).as_matrix() @ np.diag(
        trs["scale"]
    )
    matrix[:3, 3] = trs["translation"]
    return matrix


def _write_mesh(shapenet, catalog, name, size):
    mesh = trimesh.creation.box(size)
    mesh.apply_translation([0, 0.1, 0])  # ShapeNet's meshes are not centred on their boxes
    # the reader must do without the material file that the mesh names
    text = "mtllib absent.mtl\nusemtl wood\n" + export_obj(mesh)
    write_bytes(shapenet / "ShapeNetCore.v2" / catalog / name / "models/model_normalized.obj", text.encode())
    return mesh


@pytest.fixture
def annotated(tmp_path):
    """A scan with a chair and a table: paths and the annotation as written."""
    shapenet = tmp_path / "shapenet"
    _write_mesh(shapenet, CHAIR, "aa", [0.3, 0.8, 0.4])
    _write_mesh(shapenet, TABLE, "bb", [0.9, 0.4, 0.5])
    entry = {
        "id_scan": "scene0001_00",
        "trs": _trs(1, (2.0, 2.0, 2.0)),
        "aligned_models": [
            {"trs": _trs(2, (1.0, 1.2, 0.8)), "catid_cad": CHAIR, "id_cad": "aa", "sym": "__SYM_ROTATE_UP_4"},
            {
                "trs": _trs(3, (1.5, 1.1, 0.7)),
                "catid_cad": TABLE,
                "id_cad": "bb",
                "sym": "__SYM_ROTATE_UP_INF",
            },
        ],
    }
    path = tmp_path / "full_annotations.json"
    path.write_text(json.dumps([{"id_scan": "another"}, entry]))
    return path, shapenet, entry


def _placed(truth: truth_of.GroundTruth):
    return truth.vertices * truth.scale @ truth.T_world_object[:3, :3].T + truth.T_world_object[:3, 3]


def test_decomposition_places_vertices_as_scan2cad_does(annotated):
    path, shapenet, entry = annotated
    models = load_aligned_models(path, shapenet, "scene0001_00")
    assert [model.category for model in models] == ["chair", "table"]
    assert [model.truth.symmetry for model in models] == [4, 0]
    for model, written in zip(models, entry["aligned_models"], strict=True):
        T = np.linalg.inv(_matrix(entry["trs"])) @ _matrix(written["trs"])
        expected = model.truth.vertices @ T[:3, :3].T + T[:3, 3]
        np.testing.assert_allclose(_placed(model.truth), expected, atol=1e-12)
        rotation = model.truth.T_world_object[:3, :3]
        np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
        np.testing.assert_allclose(model.truth.scale, np.array(written["trs"]["scale"]) / 2)
    assert load_aligned_models(path, shapenet / "ShapeNetCore.v2", "scene0001_00")[0].category == "chair"


def test_without_annotations_there_are_no_models(annotated, tmp_path, caplog):
    path, shapenet, _ = annotated
    with caplog.at_level(logging.INFO):
        assert load_aligned_models(tmp_path / "none.json", shapenet, "scene0001_00") == []
        assert load_aligned_models(path, shapenet, "scene0009_00") == []
    assert "none.json: not there" in caplog.text
    assert "no entry for scene0009_00" in caplog.text


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda e: e["aligned_models"][1].update(id_cad="cc"), r"cc.models.model_normalized\.obj: missing"),
        (lambda e: e["aligned_models"][1].update(sym="__SYM_5"), r"aligned model 1: unknown symmetry"),
        (lambda e: e["aligned_models"][1].pop("trs"), r"aligned model 1: malformed \(KeyError"),
        (
            lambda e: e["aligned_models"][0]["trs"].update(scale=[1, 0, 1]),
            r"aligned model 0: malformed .*scale",
        ),
        (
            lambda e: e["aligned_models"][0]["trs"].update(rotation=[0, 0, 0, 0]),
            r"aligned model 0: malformed",
        ),
        (lambda e: e["trs"].update(rotation=None), r"aligned model 0: malformed .*numbers"),
        (lambda e: e["trs"].update(rotation=False), r"aligned model 0: malformed .*numbers"),
        (
            lambda e: e["trs"].update(translation=[0, 0, float("nan")]),
            r"aligned model 0: malformed .*numbers",
        ),
        (
            lambda e: e["aligned_models"][0].update(id_cad="../../../x"),
            r"aligned model 0: malformed .*outside of",
        ),
        (lambda e: e.update(aligned_models=None), r"scene0001_00: aligned_models is no list"),
        (lambda e: e["trs"].update(scale=[1, 2, 1]), r"not the same on every axis"),
    ],
)
def test_malformed_annotations_are_named(annotated, change, message):
    path, shapenet, entry = annotated
    change(entry)
    path.write_text(json.dumps([entry]))
    with pytest.raises(DatasetError, match=message):
        load_aligned_models(path, shapenet, "scene0001_00")


@pytest.mark.parametrize("content", ["", "[{]", "{}", "[1]"])
def test_a_damaged_file_is_named(annotated, content):
    path, shapenet, _ = annotated
    path.write_text(content)
    with pytest.raises(DatasetError, match=r"full_annotations\.json"):
        load_aligned_models(path, shapenet, "scene0001_00")


@pytest.mark.parametrize("content", [b"", b"v 0 0 0\nv 1 0 0\n", b"\xff\xfe\x00nonsense"])
def test_a_damaged_mesh_is_named(annotated, content):
    path, shapenet, _ = annotated
    write_bytes(shapenet / "ShapeNetCore.v2" / CHAIR / "aa" / "models/model_normalized.obj", content)
    with pytest.raises(DatasetError, match=r"aa.models.model_normalized\.obj"):
        load_aligned_models(path, shapenet, "scene0001_00")


def test_matching_goes_by_category_and_place(annotated):
    path, shapenet, _ = annotated
    models = load_aligned_models(path, shapenet, "scene0001_00")
    chair, table = (_placed(model.truth) for model in models)
    categories = {4: "table", 7: "chair", 8: "chair", 9: "chair"}
    points = {4: table, 7: chair + 0.01, 8: chair + 5.0}
    truth = match_models(models, points, categories)
    assert set(truth) == {4, 7}
    assert truth[7] is models[0].truth
    assert match_models(models, {7: table}, {7: "chair"}) == {}


@pytest.fixture(scope="module")
def real_points(shared_data):
    """Masked depth points of the real scan in the world frame, by mask value, 4000 each."""
    scan = truth_of.annotated(load_scan("scannet", shared_data / "scannet"))
    points = {k: [] for k in range(1, 8)}
    for frame in scan.frames:
        v, u = np.nonzero((frame.instances > 0) & (frame.depth > 0))
        p_camera = frame.intrinsics.backproject(u, v) * frame.depth[v, u, None]
        p_world = p_camera @ frame.T_world_camera[:3, :3].T + frame.T_world_camera[:3, 3]
        for k, parts in points.items():
            parts.append(p_world[frame.instances[v, u] == k][::10])
    rng = np.random.default_rng(0)
    return {k: rng.choice(np.concatenate(parts), 4000) for k, parts in points.items()}


def test_real_models_fit_the_masked_depth(shared_data, real_points):
    models = load_aligned_models(
        shared_data / "scan2cad" / "full_annotations.json", shared_data / "shapenet", "scene0470_00"
    )
    medians = []
    for index, model in enumerate(models):
        mesh = trimesh.Trimesh(_placed(model.truth), model.truth.faces, process=False)
        surface = trimesh.sample.sample_surface(mesh, 100_000, seed=0)[0]
        medians.append(1000 * np.median(KDTree(surface).query(real_points[index + 1])[0]))
    # the medians that the data's description states, in millimetres
    np.testing.assert_allclose(medians, [8, 16, 22, 17, 8, 4, 38], atol=3)


def test_real_instances_find_their_models(shared_data):
    scan = truth_of.annotated(load_scan("scannet", shared_data / "scannet"))
    models = load_aligned_models(
        shared_data / "scan2cad" / "full_annotations.json", shared_data / "shapenet", "scene0470_00"
    )
    assert set(scan.ground_truth) == {instance.id for instance in scan.instances}
    for instance_id, truth in scan.ground_truth.items():
        # in this folder objectId k is the k-th annotated model; a mask's value is one more
        expected = models[instance_id - 1].truth
        np.testing.assert_allclose(truth.T_world_object, expected.T_world_object)
        up = truth.T_world_object[:3, 1]
        assert up @ scan.up_world > 0.99
    assert scan.ground_truth[6].symmetry == 0
