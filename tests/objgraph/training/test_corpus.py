"""What is trained on and what is held out: by source and group, from folders of meshes, and never both."""

import json
import shutil
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_array_equal

from objgraph.errors import PriorError
from objgraph.training.meshes.corpus import CorpusConfig, build_corpus, listed
from objgraph.training.meshes.files import MeshError, MeshTimeoutError
from objgraph.training.meshes.index import CadMesh, heldout_groups, read_index
from objgraph.training.meshes.samples import SampleConfig
from objgraph.training.meshes.solid import Solid


def collected(sources: dict[str, list[str]]) -> list[CadMesh]:
    """Entries whose groups are given by source."""
    return [
        CadMesh(Path(), f"{source}/{i}.ply", f"{source}:{group}", "CC0-1.0", "", source, None)
        for source, groups in sources.items()
        for i, group in enumerate(groups)
    ]


@given(
    st.dictionaries(
        st.sampled_from("abcdef"),
        st.lists(st.sampled_from("123456789"), min_size=1, max_size=12),
        min_size=1,
    ),
    st.floats(0.05, 0.45),
)
def test_every_source_holds_out_its_share_by_whole_groups(
    sources: dict[str, list[str]], share: float
) -> None:
    entries = collected(sources)
    held = heldout_groups(entries, share)
    assert held == heldout_groups(entries[::-1], share)
    for source in sources:
        own = [entry for entry in entries if entry.source == source]
        if len({entry.group for entry in own}) > 1:
            assert sum(entry.group in held for entry in own) >= share * len(own)
    assert heldout_groups(entries, 0.0) == set()


def test_equal_files_of_a_folder_without_an_index_are_held_out_together(tmp_path: Path) -> None:
    """Else a mesh is trained on under one name and under another one measures what the prior makes of unseen ones."""
    for i in range(10):
        box = trimesh.creation.box((1.0, 1.0, 1.0 + i // 2))
        box.export(tmp_path / f"{'ab'[i % 2]}{i // 2}.ply")
    entries = read_index(tmp_path, "lamp")
    held = heldout_groups(entries, 0.2)
    assert {entry.file for entry in entries if entry.group in held} in [
        {f"a{i}.ply", f"b{i}.ply"} for i in range(5)
    ]


def test_what_an_index_holds_out_is_held_out_with_its_group_and_fills_the_share() -> None:
    entries = collected({"shop": list("aabbccddee")})
    drawn = heldout_groups(entries, 0.2)
    said = entries[0].group
    marked = [replace(entries[0], split="test"), *entries[1:]]
    assert said not in drawn
    assert heldout_groups(marked, 0.2) == {said}
    assert heldout_groups(marked, 0.0) == {said}
    assert heldout_groups(marked, 0.3) == {said} | drawn


def test_a_damaged_index_is_not_passed_over(meshes: Path, tmp_path: Path) -> None:
    other = tmp_path / "other"
    other.mkdir()
    index = (meshes / "index.json").read_text()
    (other / "index.json").write_text(index.replace('"table"', '"lamp"'))
    assert listed([other, meshes], "table") == read_index(meshes, "table")
    with pytest.raises(PriorError, match="no mesh of category 'car'"):
        listed([other, meshes], "car")
    (other / "index.json").write_text(index[:100])
    with pytest.raises(PriorError, match=f"{other}.* is no mesh index"):
        listed([meshes, other], "table")


def test_meshes_of_one_name_are_of_one_group(meshes: Path, tmp_path: Path) -> None:
    """Else one of them may be trained on and the other held out, and a card with its name takes either for unseen."""
    other = tmp_path / "other"
    shutil.copytree(meshes, other)
    assert len(listed([meshes, other], "table")) == 10
    index = (other / "index.json").read_text()
    (other / "index.json").write_text(index.replace('"group": "b"', '"group": "d"'))
    with pytest.raises(PriorError, match=rf"{meshes / 't2.ply'} and {other / 't2.ply'} have one name"):
        listed([meshes, other], "table")


ONE = CorpusConfig(procedural=0, swaps=0, copies=0, heldout_share=0.0)


def test_a_cache_that_cannot_be_written_leaves_no_mesh_out(meshes: Path, tmp_path: Path) -> None:
    (tmp_path / "cache").write_text("no folder")
    with pytest.raises(PriorError, match=r"cache.* cannot be written"):
        build_corpus("table", [meshes], ONE, SampleConfig(count=100), tmp_path / "cache")


def test_a_mesh_that_was_mended_meanwhile_is_sampled_as_it_is_now(meshes: Path, tmp_path: Path) -> None:
    """In one process, as in a notebook; the cache kept samples of the former mesh under the name of the new one."""

    def extents() -> np.ndarray:
        corpus = build_corpus("table", [meshes], ONE, SampleConfig(count=100), tmp_path / "cache")
        return next(shape.extents for shape in corpus.training if shape.name == "t0.ply#0")

    for edges in np.array([(0.6, 0.3, 0.5), (0.3, 0.6, 0.5)]):
        trimesh.creation.box(edges).export(meshes / "t0.ply")
        np.testing.assert_allclose(extents(), edges / np.linalg.norm(edges), atol=1e-6)


def test_only_what_is_no_solid_is_refused_for_ever(
    meshes: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def used() -> set[str]:
        corpus = build_corpus("table", [meshes], ONE, SampleConfig(count=100), tmp_path / "cache")
        return {entry.file for entry in corpus.used}

    def refuse(solid: Solid, *_, **__) -> None:
        raise (MeshError if solid.name == "t0.ply" else MeshTimeoutError)(solid.name)

    monkeypatch.setattr("objgraph.training.meshes.corpus.joined", lambda solid: solid)
    with monkeypatch.context() as patch:
        patch.setattr("objgraph.training.meshes.corpus.sample_solid", refuse)
        assert used() == set()
    assert used() == {"t1.ply", "t2.ply", "t3.ply"}


def test_validation_never_sees_what_is_held_out(meshes: Path, tmp_path: Path) -> None:
    (meshes / "t4.ply").write_bytes((meshes / "t0.ply").read_bytes())
    entries = read_index(meshes, "table")
    held = heldout_groups(entries, 0.2)
    settings = CorpusConfig(procedural=0, swaps=0, copies=0, validation=True)
    corpus = build_corpus("table", [meshes], settings, SampleConfig(count=600), tmp_path)
    assert corpus.used
    assert corpus.unseen
    assert held.isdisjoint(entry.group for entry in corpus.used + corpus.unseen)


@pytest.mark.parametrize(
    "content", [None, "{", "[]", '{"meshes": [{"category": "table"}]}', '{"meshes": []}']
)
def test_bad_index_is_named(tmp_path: Path, content: str | None) -> None:
    if content is not None:
        (tmp_path / "index.json").write_text(content)
    with pytest.raises(PriorError, match=r"index\.json"):
        read_index(tmp_path, "table")


@pytest.mark.parametrize(
    "change",
    [
        {"group": None},
        {"licence": 3},
        {"kind": None},
        {"size_m": [1, 2]},
        {"size_m": "abc"},
        {"size_m": [1, 0, 1]},
        {"file": None},
    ],
)
def test_an_entry_of_other_values_is_named(tmp_path: Path, change: dict) -> None:
    names = ("file", "group", "licence", "attribution", "source_repo", "category")
    entry = {**dict.fromkeys(names, "table"), "size_m": None}
    (tmp_path / "index.json").write_text(json.dumps({"meshes": [entry]}))
    assert len(read_index(tmp_path, "table")) == 1
    (tmp_path / "index.json").write_text(json.dumps({"meshes": [entry | change]}))
    with pytest.raises(PriorError, match=r"index\.json is no mesh index"):
        read_index(tmp_path, "table")


def test_any_folder_of_meshes_will_do(tmp_path: Path) -> None:
    folder = tmp_path / "lamp"
    folder.mkdir()
    (tmp_path / "sofa").mkdir()
    for i in range(6):
        shade = trimesh.creation.cylinder(0.2 + 0.1 * i, 3.0)
        shade.apply_translation([5, 0, 1])
        shade.export(folder / f"{i}.stl")
    trimesh.creation.box().export(tmp_path / "sofa" / "box.obj")
    settings = CorpusConfig(procedural=0, copies=0)
    corpus = build_corpus("lamp", [tmp_path], settings, SampleConfig(count=600), tmp_path / "cache")
    assert {entry.file for entry in corpus.used + corpus.unseen} == {f"lamp/{i}.stl" for i in range(6)}
    assert corpus.unseen
    for shape in corpus.training:
        assert np.linalg.norm(shape.extents) == pytest.approx(1)
        assert np.abs(shape.points[np.abs(shape.sdf) < 1e-3]).max() < 0.51


@pytest.mark.parametrize("name", ["trash_bin", "Trash Bin", "TRASH_BIN"])
def test_a_subfolder_of_the_category_is_one_however_it_is_spelt(tmp_path: Path, name: str) -> None:
    """Else all folders' meshes, of whatever category, would be trained on as if they were of this one."""
    for folder in (name, "Chair"):
        (tmp_path / folder).mkdir()
        trimesh.creation.box().export(tmp_path / folder / "a.ply")
    assert [entry.file for entry in listed([tmp_path], "trash_bin")] == [f"{name}/a.ply"]


def test_processes_sample_the_same_shapes_from_several_folders(meshes: Path, tmp_path: Path) -> None:
    other = tmp_path / "other" / "table"
    other.mkdir(parents=True)
    trimesh.creation.cylinder(0.5, 0.4).export(other / "round.ply")
    (other / "flat.ply").write_text("no mesh")
    folders, settings = [meshes, other.parent], CorpusConfig(procedural=6, copies=1, swaps=2)
    one, two = (
        build_corpus("table", folders, settings, SampleConfig(count=300), tmp_path / f"cache{jobs}", jobs)
        for jobs in (1, 2)
    )
    assert {entry.folder for entry in one.used + one.unseen} == set(folders)
    assert [entry.file for entry in one.used] == [entry.file for entry in two.used]
    assert set(one.skipped) == set(two.skipped) == {"t4.ply", "table/flat.ply"}
    for a, b in zip(one.training + one.heldout, two.training + two.heldout, strict=True):
        assert a.name == b.name
        assert_array_equal(a.points, b.points)
        assert_array_equal(a.sdf, b.sdf)


def test_what_is_flat_is_left_out_and_named(meshes: Path, tmp_path: Path) -> None:
    """Of a box without a depth no stretch to the category's is known: one would spoil it for all."""
    other = tmp_path / "other"
    for name, depth in (("flat #1.ply", 0.0), ("flat #2.ply", 1e-7), ("deep.ply", 0.02)):
        corners = np.array([[0, 0, 0], [1, 0, 0], [1, 1, depth], [0, 1, depth]])
        other.mkdir(exist_ok=True)
        trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]], process=False).export(other / name)
    corpus = build_corpus("table", [meshes, other], ONE, SampleConfig(count=100), tmp_path / "cache")
    assert {"flat #1.ply", "flat #2.ply"} == set(corpus.skipped) - {"t4.ply"}
    assert "mesh flat #1.ply is flat" in corpus.skipped["flat #1.ply"]
    assert "deep.ply" in {entry.file for entry in corpus.used}


def test_a_mesh_whose_name_is_no_unicode_is_told_before_any_work(tmp_path: Path) -> None:
    (tmp_path / "bl\udcfc.ply").write_bytes(b"")
    with pytest.raises(PriorError, match=r"the mesh file .*ply' is no Unicode text; rename it"):
        build_corpus("sofa", [tmp_path], ONE, SampleConfig(), tmp_path / "cache")


def test_unknown_category_needs_meshes(tmp_path: Path) -> None:
    with pytest.raises(PriorError, match=r"'lamp' has no procedural family \(chair, table, car\)"):
        build_corpus("lamp", [], CorpusConfig(), SampleConfig(), tmp_path)


def test_meshes_without_the_libraries_for_them_are_refused_before_any_work(tmp_path, monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, "manifold3d", None)
    with pytest.raises(PriorError, match=r"meshes need manifold3d: pip install 'objgraph\[train\]'"):
        build_corpus("chair", [tmp_path], CorpusConfig(), SampleConfig(), tmp_path)
