"""The map: what it refuses, what a saved one gives back, and that saving is one step."""

import json
import os
from typing import Any

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from objgraph import map_files
from objgraph.errors import MapError
from objgraph.map import ObjectMap
from objgraph.map_estimate import OtherEstimate
from objgraph.mapped_object import COVARIANCE_AXES, EVALUATION_KEYS, MappedObject, PriorReference

UP = np.array([0.0, 0.0, 1.0])
JSON_NAMES = [
    "id",
    "category",
    "status",
    "reason",
    "T_world_object",
    "scale",
    "code",
    "covariance",
    "covariance_axes",
    "code_sigma",
    "estimator",
    "other",
    "cost_initial",
    "cost_final",
    "linearizations",
    "error_evaluations",
    "seconds",
    "seconds_by_stage",
    "views",
    "size_m",
    "mesh",
    "prior",
    "evaluation",
]


def other(seed: int = 0, **changes: Any) -> OtherEstimate:
    rng = np.random.default_rng(seed)
    T = np.eye(4)
    T[:3, :3] = Rotation.random(rng=rng).as_matrix()
    given = {
        "estimator": "adam",
        "T_world_object": T,
        "scale": rng.uniform(0.5, 2, 3),
        "code": rng.normal(size=8),
        "covariance": np.diag(rng.uniform(0, 1, 9)),
        "code_sigma": rng.uniform(0, 1, 8),
    }
    return OtherEstimate(**(given | changes))


def mapped(identifier: int = 1, seed: int = 0, **changes) -> MappedObject:
    rng = np.random.default_rng(seed)
    T = np.eye(4)
    T[:3, :3] = Rotation.random(rng=rng).as_matrix()
    T[:3, 3] = rng.normal(size=3)
    root = rng.normal(size=(9, 9))
    ball = trimesh.creation.icosphere(1, radius=0.4)
    given = {
        "category": "chair",
        "status": "mapped",
        "T_world_object": T,
        "scale": rng.uniform(0.5, 2, 3),
        "code": rng.normal(size=8),
        "covariance": root @ root.T,
        "code_sigma": rng.uniform(0, 1, 8),
        "estimator": "graph",
        "cost_initial": 120.5,
        "cost_final": 3.25,
        "linearizations": 12,
        "error_evaluations": 17,
        "seconds": 4.5,
        "seconds_by_stage": {"initialise": 1.5, "solve": 3.0},
        "views": ("0", "12"),
        "size_m": rng.uniform(0.5, 2, 3),
        "prior": PriorReference("chair", "ab12"),
        "evaluation": dict.fromkeys(EVALUATION_KEYS, 0.5) | {"pose_correct": np.True_, "volume_iou": None},
        "vertices": np.asarray(ball.vertices) + T[:3, 3],
        "faces": np.asarray(ball.faces),
        "vertex_sigma": rng.uniform(0.001, 0.05, len(ball.vertices)),
    }
    return MappedObject(identifier, **(given | changes))


def failed(identifier: int = 9, reason: str = "seen in 12 pixels") -> MappedObject:
    return MappedObject(identifier, "table", "failed", reason)


def assert_same(a: MappedObject, b: MappedObject) -> None:
    for name in vars(a):
        one, other = getattr(a, name), getattr(b, name)
        if isinstance(one, np.ndarray):
            single = name in ("vertices", "vertex_sigma")
            np.testing.assert_array_equal(one.astype(np.float32) if single else one, other)
        else:
            assert one == other, name


finite = st.floats(-1e6, 1e6)


@settings(max_examples=30, deadline=None)
@given(
    seed=st.integers(0, 2**31),
    category=st.text(max_size=12),
    scene=st.text(max_size=12),
    code=st.lists(finite, max_size=6),
    cost=st.none() | finite,
    stages=st.dictionaries(st.text(max_size=5), st.floats(0, 1e3), max_size=3),
    views=st.lists(st.text(max_size=5), max_size=4),
    evaluation=st.none()
    | st.dictionaries(st.sampled_from(EVALUATION_KEYS), st.none() | st.booleans() | finite),
    drop=st.sets(
        st.sampled_from(
            ["covariance", "vertex_sigma", "size_m", "prior", "seconds", "code_sigma", "estimator"]
        )
    ),
    second=st.none() | st.builds(other, st.integers(0, 2**31), estimator=st.text(min_size=1, max_size=6)),
    reason=st.text(min_size=1, max_size=20),
)
def test_a_saved_map_comes_back_as_it_was(
    tmp_path_factory, seed, category, scene, code, cost, stages, views, evaluation, drop, second, reason
):
    entry = mapped(
        3,
        seed,
        category=category,
        code=code,
        cost_final=cost,
        seconds_by_stage=stages,
        views=tuple(views),
        evaluation=evaluation,
        other=second,
        **({"code_sigma": np.ones(len(code))} | dict.fromkeys(drop)),
    )
    folder = tmp_path_factory.mktemp("map")
    ObjectMap(scene, (entry, failed(reason=reason)), UP).save(folder)
    back = ObjectMap.load(folder)
    assert back.scene == scene
    np.testing.assert_array_equal(back.up_world, UP)
    assert_same(entry, back.objects[0])
    assert_same(failed(reason=reason), back.objects[1])


def test_the_document_has_the_promised_names_and_failed_objects_have_nulls(tmp_path):
    ObjectMap("room", (mapped(1), failed(9)), UP).save(tmp_path)
    document = json.loads((tmp_path / "map.json").read_text())
    assert set(document) == {"version", "scene", "up_world", "objects"}
    assert document["version"] == 2
    good, bad = document["objects"]
    assert set(good) == set(bad) == set(JSON_NAMES)
    assert (good["estimator"], good["other"]) == ("graph", None)
    assert good["covariance_axes"] == list(COVARIANCE_AXES)
    assert len(good["covariance_axes"]) == 9
    assert good["prior"] == {"name": "chair", "hash": "ab12"}
    assert good["evaluation"]["pose_correct"] is True
    assert (tmp_path / good["mesh"]).is_file()
    assert bad["status"] == "failed"
    assert bad["reason"] == "seen in 12 pixels"
    assert all(
        bad[name] is None
        for name in (
            "T_world_object", "scale", "code", "covariance", "mesh", "prior", "estimator", "other",
        )
    )  # fmt: skip


def test_the_glb_is_in_the_world_frame_with_colours_that_follow_sigma(tmp_path):
    entry = mapped(1)
    ObjectMap("room", (entry,), UP).save(tmp_path)
    (path,) = tmp_path.glob("*.glb")
    mesh = trimesh.load_scene(path, process=False).to_mesh()
    assert entry.vertices is not None
    assert entry.vertex_sigma is not None
    np.testing.assert_allclose(
        mesh.bounds, [entry.vertices.min(axis=0), entry.vertices.max(axis=0)], atol=1e-6
    )
    colors = mesh.visual.vertex_colors
    low, high = np.argmin(entry.vertex_sigma), np.argmax(entry.vertex_sigma)
    assert colors[high, 0] > 200  # yellow
    assert colors[low, 0] < 100 < colors[low, 2]  # blue


def test_saving_again_replaces_the_map_and_leaves_other_files_alone(tmp_path):
    ObjectMap("room", (mapped(1), mapped(2, seed=1)), UP).save(tmp_path)
    (tmp_path / "map.png").write_bytes(b"picture")
    ObjectMap("room", (mapped(1, seed=2),), UP).save(tmp_path)
    assert len(ObjectMap.load(tmp_path).objects) == 1
    assert len(list(tmp_path.glob("*.glb"))) == 1
    assert (tmp_path / "map.png").read_bytes() == b"picture"
    assert not [name for name in os.listdir(tmp_path) if name.startswith(".")]


@pytest.mark.parametrize("crash_at", [0, 1, 2])
def test_a_crash_while_saving_leaves_the_old_map_whole(tmp_path, monkeypatch, crash_at):
    old = mapped(1)
    ObjectMap("old", (old, mapped(2, seed=1)), UP).save(tmp_path)
    replace, calls = os.replace, []

    def crash(source, target):
        calls.append(target)
        if len(calls) > crash_at:
            raise KeyboardInterrupt
        replace(source, target)

    monkeypatch.setattr(map_files.os, "replace", crash)
    with pytest.raises(KeyboardInterrupt):
        ObjectMap("new", (mapped(1, seed=5), mapped(2, seed=6)), UP).save(tmp_path)
    back = ObjectMap.load(tmp_path)
    assert back.scene == "old"
    assert_same(old, back.objects[0])
    assert not [name for name in os.listdir(tmp_path) if name.startswith(".")]


def test_arrays_are_read_only_double_copies():
    code = np.ones(8, np.float32)
    entry = mapped(code=code)
    code[0] = 7
    assert entry.code is not None
    assert entry.faces is not None
    assert entry.code.dtype == np.float64
    assert entry.code[0] == 1
    with pytest.raises(ValueError, match="read-only"):
        entry.code[0] = 2
    with pytest.raises(ValueError, match="read-only"):
        entry.faces[0] = 2


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        ({"T_world_object": np.diag([2.0, 2, 2, 1])}, "T_world_object is no rigid"),
        ({"T_world_object": np.eye(3)}, r"T_world_object has shape \(3, 3\)"),
        ({"scale": [1, -1, 1]}, "scale must be positive"),
        ({"code": None}, "code is missing"),
        ({"code": [np.nan] * 8}, "code is not finite"),
        ({"covariance": -np.eye(9)}, "covariance has a negative variance"),
        ({"covariance": np.full((9, 9), np.inf)}, "covariance is not finite"),
        ({"code_sigma": np.ones(3)}, "code_sigma has 3 entries"),
        ({"cost_final": float("nan")}, "cost_final is not finite"),
        ({"seconds_by_stage": {"solve": float("inf")}}, "seconds_by_stage.solve is not finite"),
        ({"evaluation": {"box_iou": np.float64("nan")}}, "evaluation.box_iou is not finite"),
        ({"linearizations": 1.5}, "linearizations is no whole number"),
        ({"status": "lost"}, "status is 'lost'"),
        ({"status": "failed"}, "reason must say why"),
        ({"faces": None}, "faces is missing"),
        ({"faces": [[0, 1, 4000]]}, "faces is empty or names vertices outside"),
        ({"vertex_sigma": np.ones(2)}, "vertex_sigma has 2 entries"),
    ],
)
def test_what_cannot_be_is_refused_with_object_and_field(changes, complaint):
    with pytest.raises(MapError, match=rf"object 7 \(chair\): {complaint}"):
        mapped(7, **changes)


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        ({"estimator": None}, "estimator"),
        ({"T_world_object": None}, "T_world_object is missing"),
        ({"scale": None}, "scale is missing"),
        ({"code": None}, "code is missing"),
        ({"covariance": None}, "covariance is missing"),
        ({"code_sigma": None}, "code_sigma is missing"),
        ({"T_world_object": np.eye(3)}, "T_world_object has shape"),
        ({"T_world_object": np.diag([2.0, 2, 2, 1])}, "the pose must be rigid"),
        ({"T_world_object": np.diag([1.0, 1, -1, 1])}, "the pose must be rigid"),
        ({"scale": [1, 0, 1]}, "scale positive"),
        ({"scale": "x"}, "scale is no array"),
        ({"code": np.ones((2, 4))}, "code has shape"),
        ({"covariance": np.eye(8)}, "covariance has shape"),
        ({"covariance": np.diag([1.0] * 8 + [-1e-3])}, "covariance"),
        ({"code_sigma": np.ones(3)}, "code_sigma"),
    ],
)
def test_another_estimate_that_cannot_be_is_refused(changes, complaint):
    with pytest.raises(MapError, match=f"other estimate.*{complaint}"):
        other(**changes)


@given(
    name=st.sampled_from(["T_world_object", "scale", "code", "covariance", "code_sigma"]),
    value=st.sampled_from([np.nan, np.inf, -np.inf]),
    where=st.integers(0, 80),
)
def test_another_estimate_is_finite(name, value, where):
    array = np.array(getattr(other(), name))
    array.flat[where % array.size] = value
    with pytest.raises(MapError, match=f"other estimate: {name} is not finite"):
        other(0, **{name: array})


@given(st.integers(0, 2**31))
def test_another_estimate_comes_back_from_its_json(seed):
    one = other(seed)
    again = OtherEstimate.from_json(json.loads(json.dumps(one.to_json())))
    assert again == one
    for name in ("T_world_object", "scale", "code", "covariance", "code_sigma"):
        np.testing.assert_array_equal(getattr(again, name), getattr(one, name))
        assert not getattr(again, name).flags.writeable
    assert one != other(seed, estimator="graph")
    assert one != other(seed, code=one.code + 1e-9)
    assert one != one.to_json()


@pytest.mark.parametrize(
    "document",
    [None, 3, [], {}, {"estimator": "adam"}, other().to_json() | {"more": 1}],
)
def test_json_of_another_estimate_has_its_names_and_no_more(document):
    with pytest.raises(MapError, match="other estimate must have estimator, T_world_object, scale, code"):
        OtherEstimate.from_json(document)


def test_ids_are_unique_and_up_is_a_unit_vector():
    with pytest.raises(MapError, match=r"id \[1\]"):
        ObjectMap("room", (mapped(1), failed(1)), UP)
    with pytest.raises(MapError, match="up_world"):
        ObjectMap("room", (), np.array([0, 0, 2.0]))


def broken(folder, change):
    ObjectMap("room", (mapped(1),), UP).save(folder)
    document = json.loads((folder / "map.json").read_text())
    change(document)
    (folder / "map.json").write_text(json.dumps(document))


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        (lambda d: d.pop("scene"), "scene missing"),
        (lambda d: d.update(version=99), "version 99"),
        (lambda d: d.update(version=1), "version 1 "),
        (lambda d: d["objects"][0].pop("other"), r"objects\[0\]: other missing"),
        (lambda d: d["objects"][0].update(other=3), r"objects\[0\]: other estimate must have estimator, T_w"),
        (
            lambda d: d["objects"][0].update(other=other().to_json() | {"scale": [1, 2]}),
            r"objects\[0\]: other estimate: scale has shape",
        ),
        (lambda d: d.update(objects={}), "objects is no list"),
        (lambda d: d.update(objects=[3]), r"objects\[0\] is no JSON object"),
        (lambda d: d.update(up_world=[1, 2]), "up_world"),
        (lambda d: d["objects"][0].pop("cost_final"), r"objects\[0\]: cost_final missing"),
        (
            lambda d: d["objects"][0].update(scale=[1, 2]),
            r"objects\[0\]: object 1 \(chair\): scale has shape",
        ),
        (lambda d: d["objects"][0].update(scale="x"), r"objects\[0\]: .*scale is no array"),
        (lambda d: d["objects"][0].update(id=None), r"objects\[0\]: .*id is missing"),
        (lambda d: d["objects"][0].update(category=4), r"objects\[0\]: .*category is no text"),
        (lambda d: d["objects"][0].update(covariance_axes=["x"]), r"objects\[0\]: covariance_axes"),
        (lambda d: d["objects"][0].update(prior={"name": "x"}), r"objects\[0\]: prior must have"),
        (lambda d: d["objects"][0].update(views=3), r"objects\[0\]: views is a int"),
        (lambda d: d["objects"][0].update(mesh="../x.glb"), r"objects\[0\]: mesh '../x.glb'"),
        (lambda d: d["objects"][0].update(mesh="gone.glb"), "gone.glb.*not there"),
        (lambda d: d["objects"][0].update(cost_final=float("nan")), "NaN is no JSON number"),
    ],
)
def test_a_broken_document_is_named_with_its_file_and_field(tmp_path, change, complaint):
    broken(tmp_path, change)
    with pytest.raises(MapError, match=complaint) as caught:
        ObjectMap.load(tmp_path)
    assert str(tmp_path) in str(caught.value)


def test_missing_and_truncated_files_are_named(tmp_path):
    with pytest.raises(MapError, match=r"map\.json: there is no map here"):
        ObjectMap.load(tmp_path)
    ObjectMap("room", (mapped(1),), UP).save(tmp_path)
    (mesh,) = tmp_path.glob("*.glb")
    mesh.write_bytes(mesh.read_bytes()[:200])
    with pytest.raises(MapError, match=mesh.name):
        ObjectMap.load(tmp_path)
    document = tmp_path / "map.json"
    document.write_text(document.read_text()[:100])
    with pytest.raises(MapError, match="not a readable JSON"):
        ObjectMap.load(tmp_path)


def test_a_folder_that_cannot_be_made_is_named(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(MapError, match="cannot be written"):
        ObjectMap("room", (), UP).save(tmp_path / "file" / "map")
