"""The registry: names, scenes and options."""

import pytest

from objgraph.datasets import Loader, datasets, load_scan, register, registry, scenes
from objgraph.errors import DatasetError
from tests.objgraph.datasets.dataset_folders import SCENE, toy_scan, write_exported_scan, write_tum_sequence


def test_unknown_dataset_lists_those_available(tmp_path):
    with pytest.raises(
        DatasetError, match=r"no data set 'replica'.*icl, nerfstudio, sample, scannet, sevenscenes"
    ):
        load_scan("replica", tmp_path)
    with pytest.raises(DatasetError, match="no data set 'replica'"):
        scenes("replica", tmp_path)


def test_unknown_option_lists_those_available(tmp_path):
    write_exported_scan(tmp_path)
    with pytest.raises(DatasetError, match=r"no option fps; it has stride, categories"):
        load_scan("scannet", tmp_path, fps=3)


def test_scenes_and_choice(tmp_path):
    write_exported_scan(tmp_path, 1)
    assert scenes("scannet", tmp_path) == [SCENE]
    assert load_scan("scannet", str(tmp_path)).name == SCENE  # pyright: ignore[reportArgumentType]
    write_exported_scan(tmp_path, 1, "scene0002_00")
    with pytest.raises(DatasetError, match=rf"several scenes: name one; available: {SCENE}, scene0002_00"):
        load_scan("scannet", tmp_path)
    with pytest.raises(DatasetError, match=rf"no scene 'scene9'; available: {SCENE}, scene0002_00"):
        load_scan("scannet", tmp_path, "scene9")
    assert load_scan("scannet", tmp_path, "scene0002_00").name == "scene0002_00"


@pytest.mark.parametrize("dataset", ["scannet", "sevenscenes"])
def test_empty_or_missing_root(tmp_path, dataset):
    (tmp_path / "empty" / "scans").mkdir(parents=True)
    with pytest.raises(DatasetError, match="no scenes here"):
        load_scan(dataset, tmp_path / "empty")
    with pytest.raises(DatasetError, match="absent"):
        load_scan(dataset, tmp_path / "absent")


@pytest.mark.parametrize("dataset", ["scannet", "sevenscenes"])
def test_stride_must_be_positive(tmp_path, dataset):
    with pytest.raises(DatasetError, match="stride 0"):
        load_scan(dataset, tmp_path, stride=0)


def test_a_file_may_be_named_by_text(tmp_path):
    folder = write_tum_sequence(tmp_path / "toy", toy_scan())
    trajectory, intrinsics = (str(folder / name) for name in ("groundtruth.txt", "intrinsics.txt"))
    scan = load_scan("tum", folder, trajectory=trajectory, intrinsics=intrinsics)
    assert scan.frames.names == load_scan("tum", folder).frames.names
    with pytest.raises(DatasetError, match=r"absent\.txt: cannot be read"):
        load_scan("tum", folder, trajectory="absent.txt")


def test_a_loader_of_the_callers_own(tmp_path, monkeypatch):
    monkeypatch.setattr(registry, "_LOADERS", dict(registry._LOADERS))
    write_exported_scan(tmp_path)
    scannet = registry._LOADERS["scannet"]
    register("mine", Loader(scannet.load, scannet.scenes))
    assert "mine" in datasets()
    assert len(load_scan("mine", tmp_path, stride=2).frames) == 2
    with pytest.raises(DatasetError, match="registered already"):
        register("mine", scannet)
