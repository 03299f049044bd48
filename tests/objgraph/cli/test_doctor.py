"""`objgraph doctor`: what it prints, its exit status and its picture."""

import json
import re
import shutil

import pytest

from objgraph.cli import map as cli_map
from objgraph.cli.main import main
from objgraph.doctor import scan as doctor_scan
from objgraph.errors import OutputError
from objgraph.show import doctor_picture
from tests.objgraph.doctor.doctor_cases import FRAMES, edit, write_healthy_folder


@pytest.fixture(scope="module")
def healthy(tmp_path_factory):
    return write_healthy_folder(tmp_path_factory.mktemp("doctor"))


@pytest.fixture
def folder(healthy, tmp_path):
    """A copy that a test may damage."""
    return shutil.copytree(healthy, tmp_path / "room")


def test_without_a_folder_the_machine_is_looked_at(capsys):
    assert main(["doctor"]) == 0
    printed = capsys.readouterr().out
    for word in (
        "Python",
        "torch",
        "processor",
        "memory",
        "chair",
        "sha256",
        "extra train",
        "nothing is wrong",
    ):
        assert word in printed
    assert "frames" not in printed


def test_a_healthy_folder_is_status_0_and_drawn(healthy, tmp_path, capsys):
    assert main(["doctor", "--root", str(healthy), "--out", str(tmp_path / "out")]) == 0
    printed = capsys.readouterr().out
    assert f"{FRAMES} of {FRAMES} can be read" in printed
    assert "torch" in printed
    assert "nothing is wrong" in printed
    assert (tmp_path / "out" / "doctor.png").read_bytes().startswith(b"\x89PNG")


def test_something_wrong_is_status_1_and_says_what_to_do(folder, capsys):
    edit(folder / "instances.json", lambda c: c["instances"].update({"77": "[b]"}))
    assert main(["doctor", "--dataset", "folder", "--root", str(folder)]) == 1
    printed = capsys.readouterr().out
    assert "wrong: [b] 77: is named, and no mask shows it" in printed
    assert "do: give its pixels the value 77 in masks/" in printed
    assert "note: objects: there is no shape prior for [b]" in printed
    assert printed.endswith("1 wrong\n")


def test_what_the_loader_warns_of_is_told_once(folder, capsys):
    (folder / "masks" / "1.png").unlink()
    assert main(["doctor", "--root", str(folder)]) == 0
    assert capsys.readouterr().out.count("have no mask and are left out") == 1


def test_a_folder_that_cannot_be_read_is_status_1(tmp_path, capsys):
    out = tmp_path / "out"
    assert main(["doctor", "--root", str(tmp_path / "absent"), "--out", str(out)]) == 1
    assert "absent: no such folder" in capsys.readouterr().out
    assert not out.exists()


def test_another_trajectory_is_looked_at(folder, tmp_path, capsys):
    own = tmp_path / "slam.txt"
    lines = (folder / "poses.txt").read_text().splitlines()
    own.write_text("\n".join(f"{line.split()[0]} 0 0 0 0 0 0 1" for line in lines))
    assert main(["doctor", "--root", str(folder), "--trajectory", str(own)]) == 1
    assert f"all {FRAMES} poses are equal" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--dataset", "scannet"], "data set 'scannet': --root must name its folder"),
        (["--out", "x"], "data set 'folder': --root must name its folder"),
        (["--dataset", "kitti", "--root", "x", "--out", "x"], "there is no picture of a LiDAR's scan"),
        (["--dataset", "kitti", "--root", "x", "--topic.pose", "/tf"], "no --trajectory and no --topic"),
    ],
)
def test_options_that_do_not_go_together(arguments, message, capsys):
    assert main(["doctor", *arguments]) == 1
    assert message in capsys.readouterr().err


def test_a_picture_that_cannot_be_written_is_one_line(healthy, tmp_path, capsys):
    (tmp_path / "file").write_text(json.dumps({}))
    assert main(["doctor", "--root", str(healthy), "--out", str(tmp_path / "file")]) == 1
    assert "doctor.png: cannot be written" in capsys.readouterr().err


def test_where_the_picture_fails_the_rest_is_told(healthy, tmp_path, monkeypatch, capsys):
    def full(*arguments):
        raise OutputError("doctor.png: cannot be written (No space left on device)")

    monkeypatch.setattr(doctor_picture, "doctor_picture", full)
    assert main(["doctor", "--root", str(healthy), "--out", str(tmp_path / "out")]) == 1
    printed = capsys.readouterr().out
    assert f"{FRAMES} of {FRAMES} can be read" in printed
    assert "doctor.png: cannot be written (No space left on device)" in printed
    assert printed.endswith("1 wrong\n")


@pytest.mark.parametrize("verb", ["doctor", "map", "sensor"])
def test_where_it_cannot_write_it_reads_nothing(verb, healthy, tmp_path, monkeypatch, capsys):
    for module in (cli_map, doctor_scan):
        monkeypatch.setattr(module, "load_scan", lambda *_, **__: pytest.fail("too late"))
    (tmp_path / "file").touch()
    out = tmp_path / "file" / ("sensor.json" if verb == "sensor" else "out")
    words = ["--dataset", "folder", "--root", str(healthy), "--out", str(out)]
    assert main([verb, *words]) == 1
    assert re.search(f"{out}.*: cannot be written", capsys.readouterr().err)


def test_kitti_scans_are_looked_at(shared_data, capsys):
    assert main(["doctor", "--dataset", "kitti", "--root", str(shared_data / "kitti")]) == 0
    assert "22 detected" in capsys.readouterr().out
