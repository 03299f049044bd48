"""`objgraph map --scenes`: many scans in folders of their own, by whatever engine, and again from where it was."""

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from objgraph.cli import map as map_command
from objgraph.cli.main import main
from objgraph.cli.run_config import MapRun, Source
from objgraph.datasets import scannet
from objgraph.maps import MappingConfig, ObjectMap
from objgraph.maps.mapped_object import PriorReference
from objgraph.observation.frames import Scan
from objgraph.priors.registry import load_prior
from objgraph.priors.store import save_prior
from objgraph.synthetic.camera import CameraConfig
from objgraph.synthetic.sample import SampleConfig, generate_sample
from objgraph.trust import Trust, load_calibration
from tests.objgraph.datasets.dataset_folders import write_plain_folder
from tests.objgraph.maps.map_cases import mapped
from tests.objgraph.trust.calibrations import calibration

SAMPLE = SampleConfig(camera=CameraConfig(frames=4, width=160, height=120))
FEW = ["--views", "1", "--mesh-resolution", "16", "--min-pixels", "40"]
NOTHING = ["--views", "1", "--min-pixels", "99999"]
"""Every object fails at once."""


@pytest.fixture(scope="module")
def scans(tmp_path_factory) -> Path:
    """Two scans of one chair, and one without a depth image."""
    root = tmp_path_factory.mktemp("scans")
    whole = scannet.load(generate_sample(root / "sample", SAMPLE) / "scannet")
    chair = next(each for each in whole.instances if each.category == "chair")
    for name in ("a", "b", "c"):
        write_plain_folder(root / "all" / name, Scan(name, whole.frames, (chair,), whole.up_world))
    for path in (root / "all" / "c" / "depth").iterdir():
        path.unlink()
    return root / "all"


def run(root: Path, out: Path, *options: str) -> int:
    return main(["map", "--dataset", "folder", "--root", str(root), "--out", str(out), *options])


def without_times(value: Any) -> Any:
    if isinstance(value, dict):
        return {k: without_times(v) for k, v in value.items() if not k.startswith("seconds")}
    return [without_times(v) for v in value] if isinstance(value, list) else value


def document(folder: Path) -> str:
    return json.dumps(without_times(json.loads((folder / "map.json").read_bytes())))


def test_maps_are_the_same_by_one_process_by_two_and_by_ray(scans, tmp_path, capsys):
    pytest.importorskip("ray", reason="the package ray is not installed (pip install 'objgraph[ray]')")
    listed = tmp_path / "scenes.txt"
    listed.write_text("a\nb\n")
    ways = {"one": ["--jobs", "1"], "two": ["--jobs", "2"], "ray": ["--jobs", "2", "--engine", "ray"]}
    for name, options in ways.items():
        assert run(scans, tmp_path / name, "--scenes", str(listed), *FEW, *options) == 0
        assert "2 of 2 scans are mapped" in capsys.readouterr().out
    for scene in ("a", "b"):
        assert (
            json.loads((tmp_path / "one" / scene / "map.json").read_bytes())["objects"][0]["status"]
            == "mapped"
        )
        assert len({document(tmp_path / name / scene) for name in ways}) == 1


def test_a_scan_that_fails_stops_no_other_and_is_tried_again(scans, tmp_path, capsys):
    root, out = tmp_path / "scans", tmp_path / "maps"
    shutil.copytree(scans, root)
    every = ["--scenes", "all", "--jobs", "1", *NOTHING]
    assert run(root, out, *every) == 1
    said = capsys.readouterr()
    assert "c: failed: " in said.out
    assert "1 of 3 scans failed: c" in said.err
    assert sorted(path.name for path in out.iterdir()) == ["a", "b"]
    # the other two are left as they are, and the third is mapped once it can be
    before = {name: (out / name / "map.json").stat().st_mtime_ns for name in ("a", "b")}
    for path in (root / "a" / "depth").iterdir():
        shutil.copy(path, root / "c" / "depth")
    assert run(root, out, *every) == 0
    assert {name: (out / name / "map.json").stat().st_mtime_ns for name in before} == before
    assert (out / "c" / "report.html").is_file()
    # maps of other settings are not taken for these
    assert run(root, out, *every, "--seed", "9") == 1
    assert "holds a map of other settings" in capsys.readouterr().err.replace("\n", "")


@pytest.mark.parametrize(("made_anew", "word"), [("calibration", "calibration"), ("prior", "priors")])
def test_a_map_by_a_file_that_was_made_anew_is_not_taken_for_one_by_it(
    made_anew, word, scans, tmp_path, capsys
):
    prior = load_prior("chair")
    shown, known, listed = (tmp_path / name for name in ("prior.safetensors", "mine.json", "scenes.txt"))
    save_prior(prior, shown)
    calibration(prior.digest).save(known)
    listed.write_text("a\n")
    trust = Trust(0.75, 0.5, calibration=load_calibration(known).digest)
    entry = mapped(prior=PriorReference("chair", prior.digest), trust=trust)
    ObjectMap("a", (entry,), np.array([0.0, 0.0, 1.0])).save(tmp_path / "a")
    settings = MappingConfig(priors=(str(shown),), calibration=str(known))
    MapRun(Source("folder", scans, "a"), settings).save(tmp_path / "a")
    for name in ("map.png", "report.html"):
        (tmp_path / "a" / name).touch()
    every = ["--scenes", str(listed), "--priors", str(shown), "--calibration", str(known)]
    assert run(scans, tmp_path, *every) == 0
    assert "a: " not in capsys.readouterr().out
    if made_anew == "prior":
        save_prior(replace(prior, code_mean=prior.code_mean + 0.1), shown)
    else:
        calibration("of another prior").save(known)
    assert run(scans, tmp_path, *every) == 1
    assert f"holds a map of other {word}:" in capsys.readouterr().err.replace("\n", " ")


def test_a_page_that_was_made_after_a_stop_does_not_make_a_scan_done(scans, tmp_path, capsys):
    listed = tmp_path / "scenes.txt"
    listed.write_text("a\n")
    again = ["--scenes", str(listed), "--jobs", "1", *FEW]
    assert run(scans, tmp_path, *again) == 0
    capsys.readouterr()
    assert run(scans, tmp_path, *again) == 0
    assert "a: " not in capsys.readouterr().out
    (tmp_path / "a" / "map.png").unlink()  # as if stopped before it
    assert main(["report", str(tmp_path / "a")]) == 0
    assert run(scans, tmp_path, *again) == 0
    assert "a: 1 of 1 objects" in capsys.readouterr().out
    assert (tmp_path / "a" / "map.png").is_file()


def test_a_scan_of_a_lidar_that_is_a_link_goes_on_and_is_found_again(tmp_path, capsys, caplog):
    folder, root, out = tmp_path / "store" / "2024-05-01", tmp_path / "scans", tmp_path / "maps"
    folder.mkdir(parents=True)
    np.ones((50, 4), np.float32).tofile(folder / "points.bin")
    box = {"category": "car", "centre": [20, 5, 0], "size": [4, 2, 1.5], "yaw": 0.1}
    (folder / "detections.json").write_text(json.dumps({"boxes": [box]}))
    root.mkdir()
    (root / "corner").symlink_to(folder)
    every = ["map", "--dataset", "lidar", "--root", str(root), "--scenes", "all", "--jobs", "1"]
    for _ in range(2):
        assert main([*every, "--out", str(out)]) == 0
    assert json.loads((out / "corner" / "config.json").read_text())["scene"] == "corner"
    assert main(["report", str(out / "corner")]) == 0
    assert "no points" not in caplog.text


@pytest.mark.parametrize("boxes", [1, 0])
def test_a_scan_with_nothing_to_be_mapped_is_no_failure(boxes, tmp_path, capsys):
    root, out = tmp_path / "scans", tmp_path / "maps"
    box = {"category": "car", "centre": [20, 5, 0], "size": [4, 2, 1.5], "yaw": 0.1}
    for name, found in (("a", [box] * boxes), ("b", [])):
        (root / name).mkdir(parents=True)
        np.ones((50, 4), np.float32).tofile(root / name / "points.bin")
        (root / name / "detections.json").write_text(json.dumps({"boxes": found}))
    every = ["map", "--dataset", "lidar", "--root", str(root), "--scenes", "all", "--jobs", "1"]
    assert main([*every, "--out", str(out)]) == (0 if boxes else 1)  # of a wrong category, all say so
    said = capsys.readouterr()
    assert "b: left out: frame b: nothing is detected" in said.out
    assert f"{boxes} of 2 scans are mapped in {out}, {2 - boxes} have nothing to be mapped" in said.out
    assert ("no scan has anything to be mapped" in said.err) == (not boxes)


def test_pictures_of_an_earlier_map_do_not_stay_beside_a_new_one(scans, tmp_path):
    for name in ("map.png", "report.html", "evaluation.json"):
        (tmp_path / name).write_bytes(b"of an earlier map")
    assert run(scans, tmp_path, "--scene", "a", "--jobs", "1", *NOTHING) == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == ["config.json", "map.json", "report.html"]
    assert (tmp_path / "report.html").read_bytes() != b"of an earlier map"


def test_a_page_that_fails_leaves_none(scans, tmp_path, monkeypatch, capsys):
    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(map_command, "write_report", full)
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "report.html").write_bytes(b"of an earlier map")
    assert run(scans, tmp_path, "--scenes", "all", "--jobs", "1", *NOTHING) == 1
    assert not (tmp_path / "a" / "report.html").exists()


def test_an_error_that_nobody_foresaw_is_that_scan_s_alone(scans, tmp_path, monkeypatch, capsys):
    def fail(folder, *_):
        if folder.name == "a":
            raise OSError(28, "No space left on device")
        return folder

    monkeypatch.setattr(map_command, "write_report", fail)
    (tmp_path / "two words.txt").write_text("\ufeff a \r\n\r\nb\r\n", encoding="utf-8")
    assert (
        run(scans, tmp_path / "out", "--scenes", str(tmp_path / "two words.txt"), "--jobs", "1", *NOTHING)
        == 1
    )
    said = capsys.readouterr()
    assert "a: failed: OSError: [Errno 28] No space left on device" in said.out
    assert "b: 0 of 1 objects" in said.out
    assert "1 of 2 scans failed: a" in said.err


@pytest.mark.parametrize(
    ("options", "problem"),
    [
        (["--scenes", "nofile"], "--scenes takes 'all' or a file of names"),
        (["--scenes", "EMPTY"], "there is no scan"),
        (["--scenes", "HERE"], "'.' is no name of a scan"),
        (["--scenes", "all", "--jobs", "0"], "--jobs"),
        (["--scenes", "UP"], "'../a' is no name of a scan"),
        (["--scenes", "all", "--scene", "a"], "--scene names one scan, --scenes many"),
        (["--scenes", "all", "--trajectory", "slam.txt"], "slam.txt is one's trajectory"),
        (["--scenes", "all", "--config", "OWN"], "slam.txt is one's trajectory"),
    ],
)
def test_what_is_no_list_of_scans_is_told(options, problem, scans, tmp_path, capsys):
    (tmp_path / "EMPTY").write_text("\n")
    (tmp_path / "UP").write_text("a\n../a\n")
    (tmp_path / "HERE").write_text(".\n")
    (tmp_path / "OWN").write_text('{"trajectory": "slam.txt"}')
    options = [str(tmp_path / word) if word in ("EMPTY", "UP", "HERE", "OWN") else word for word in options]
    assert run(scans, tmp_path / "out", *options) == 1
    assert problem in capsys.readouterr().err.replace("\n", "")
    assert not (tmp_path / "out").exists()
