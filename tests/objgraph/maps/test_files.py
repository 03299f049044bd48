"""What a saved map gives back, and that saving is one step."""

import json
import os
from threading import Thread, current_thread

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from objgraph.errors import MapError
from objgraph.maps import files as map_files
from objgraph.maps.mapped_object import BOX_COVARIANCE_AXES, COVARIANCE_AXES
from objgraph.maps.object_map import ObjectMap
from tests.objgraph.maps.map_cases import UP, assert_same, failed, mapped, other

JSON_NAMES = [
    "id",
    "category",
    "cameras",
    "turned",
    "trust",
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
    "box_centre",
    "box_extents",
    "box_covariance",
    "box_covariance_axes",
    "turns",
    "mesh",
    "joint_covariance",
    "prior",
]


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
    drop=st.sets(
        st.sampled_from(
            [
                "covariance",
                "vertex_sigma",
                "size_m",
                "prior",
                "seconds",
                "code_sigma",
                "estimator",
                "cameras",
                "turned",
                "trust",
            ]
        )
    ),
    second=st.none() | st.builds(other, st.integers(0, 2**31), estimator=st.text(min_size=1, max_size=6)),
    reason=st.text(min_size=1, max_size=20),
)
def test_a_saved_map_comes_back_as_it_was(
    tmp_path_factory, seed, category, scene, code, cost, stages, views, drop, second, reason
):
    entry = mapped(
        3,
        seed,
        category=category,
        code=code,
        cost_final=cost,
        seconds_by_stage=stages,
        views=tuple(views),
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
    assert document["version"] == 7
    good, bad = document["objects"]
    assert set(good) == set(bad) == set(JSON_NAMES)
    assert (good["estimator"], good["other"]) == ("graph", None)
    assert good["covariance_axes"] == list(COVARIANCE_AXES)
    assert len(good["covariance_axes"]) == 9
    assert good["box_covariance_axes"] == list(BOX_COVARIANCE_AXES)
    assert bad["box_covariance"] is bad["box_covariance_axes"] is None
    assert good["prior"] == {"name": "chair", "hash": "ab12"}
    assert (tmp_path / good["mesh"]).is_file()
    assert (tmp_path / good["joint_covariance"]).is_file()
    assert bad["status"] == "failed"
    assert bad["reason"] == "seen in 12 pixels"
    assert all(
        bad[name] is None
        for name in (
            "T_world_object", "scale", "code", "covariance", "mesh", "joint_covariance", "prior", "estimator", "other",
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
    assert len(list(tmp_path.glob("*.glb"))) == len(list(tmp_path.glob("*.safetensors"))) == 1
    assert (tmp_path / "map.png").read_bytes() == b"picture"
    assert not [name for name in os.listdir(tmp_path) if name.startswith(".")]


def test_the_errors_of_an_earlier_map_do_not_stay_beside_a_new_one(tmp_path):
    ObjectMap("room", (mapped(1),), UP).save(tmp_path)
    (tmp_path / "evaluation.json").write_text("{}")
    ObjectMap("another room", (failed(1),), UP).save(tmp_path)
    assert not (tmp_path / "evaluation.json").exists()


@pytest.mark.parametrize("crash_at", [0, 1, 2, 3, 4])
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


def test_of_two_that_save_at_once_the_last_one_s_map_is_whole(tmp_path, monkeypatch):
    """Each removes files that its own document does not name: those of the other, before it has one."""
    first, second = (ObjectMap(name, (mapped(1, seed),), UP) for seed, name in enumerate(("a", "b")))
    write, meanwhile = map_files.write_file, Thread(target=first.save, args=(tmp_path,))

    def interrupted(path, data, error):
        if path.name == "map.json" and current_thread() is not meanwhile:
            meanwhile.start()
            meanwhile.join(1.0)
        write(path, data, error)

    monkeypatch.setattr(map_files, "write_file", interrupted)
    second.save(tmp_path)
    meanwhile.join()
    back = ObjectMap.load(tmp_path)
    assert back.scene == "a"
    assert_same(first.objects[0], back.objects[0])
    assert len(list(tmp_path.glob("*.glb"))) == 1


def broken(folder, change):
    ObjectMap("room", (mapped(1),), UP).save(folder)
    document = json.loads((folder / "map.json").read_text())
    change(document)
    (folder / "map.json").write_text(json.dumps(document))


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        (lambda d: d.pop("scene"), "scene missing"),
        (lambda d: d.update(version=99), "of format 99, newer"),
        (lambda d: d.update(version=5), "of format 5, not"),
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
        (lambda d: d["objects"][0].update(scale="x"), r"objects\[0\]: .*scale is an array of <U1"),
        (lambda d: d["objects"][0].update(scale=[10**400, 1, 1]), "more than 64 bits"),
        (lambda d: d["objects"][0].update(cost_final=10**20), "more than 64 bits"),
        (lambda d: d.update(up_world=[10**400, 0, 0]), "more than 64 bits"),
        (lambda d: d.update(scene="\ud800"), "surrogates"),
        (
            lambda d: d["objects"][0]["prior"].update(name=3),
            r"objects\[0\]: prior must have a name .*name must be str",
        ),
        (lambda d: d["objects"][0].update(id=None), r"objects\[0\]: .*id must be a whole number, not None"),
        (lambda d: d["objects"][0].update(category=4), r"objects\[0\]: .*category is no text"),
        (lambda d: d["objects"][0].update(covariance_axes=["x"]), r"objects\[0\]: covariance_axes"),
        (lambda d: d["objects"][0].update(box_covariance_axes=["x"]), r"objects\[0\]: box_covariance_axes"),
        (lambda d: d["objects"][0].update(box_centre=None), "box_covariance needs box_centre"),
        (lambda d: d["objects"][0].update(prior={"name": "x"}), r"objects\[0\]: prior must have"),
        (lambda d: d["objects"][0].update(views=3), r"objects\[0\]: views is a int"),
        (lambda d: d["objects"][0].update(mesh="../x.glb"), r"objects\[0\]: mesh '../x.glb'"),
        (lambda d: d["objects"][0].update(mesh="gone.glb"), "gone.glb.*not there"),
        (lambda d: d["objects"][0].update(joint_covariance="a/b.safetensors"), "joint_covariance 'a/b"),
        (lambda d: d["objects"][0].update(joint_covariance="x.pt"), r"not the name of a \.safetensors file"),
        (
            lambda d: d["objects"][0].update(joint_covariance="gone.safetensors"),
            "gone.safetensors.*not there",
        ),
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
    ObjectMap("room", (mapped(1),), UP).save(tmp_path)
    (joint,) = tmp_path.glob("*.safetensors")
    joint.write_bytes(joint.read_bytes()[:200])
    with pytest.raises(MapError, match=joint.name):
        ObjectMap.load(tmp_path)
    document = tmp_path / "map.json"
    document.write_text(document.read_text()[:100])
    with pytest.raises(MapError, match="not a readable JSON"):
        ObjectMap.load(tmp_path)


def test_a_folder_that_cannot_be_made_is_named(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(MapError, match="cannot be written"):
        ObjectMap("room", (), UP).save(tmp_path / "file" / "map")
