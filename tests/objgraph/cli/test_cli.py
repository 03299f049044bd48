"""The command line: what the user can mend is one line and the status 1, never a traceback."""

import errno
import json
import os
import re
import subprocess
import sys

import numpy as np
import pytest

from objgraph.cli.main import VERBS, main
from objgraph.errors import ObjectGraphError
from objgraph.maps.mapped_object import MappedObject
from objgraph.maps.object_map import ObjectMap
from objgraph.priors.fallback import fallback_prior
from objgraph.priors.registry import WEIGHTS, available_priors
from objgraph.priors.store import save_prior


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--dataset", "nope"], "data set 'nope': --root must name its folder"),
        (
            ["--dataset", "nope", "--root", "."],
            "no data set 'nope'; available: bag, bop, folder, icl, nerfstudio, sample, scannet, sevenscenes",
        ),
        ([], "no data set: --dataset must name one"),
        (["--config", "{}/absent.json"], "{}/absent.json: not a readable JSON file"),
        (["--dataset", "scannet"], "data set 'scannet': --root must name its folder"),
        (["--dataset", "scannet", "--root", "{}/absent"], "{}/absent"),
        (["--dataset", "sevenscenes", "--root", "{}/absent"], "{}/absent"),
        (["--dataset", "scannet", "--root", "{}", "--scene", "scene9"], "scans"),
        (["--dataset", "sevenscenes", "--root", "{}", "--scan2cad", "."], "has no option scan2cad"),
        (["--dataset", "scannet", "--root", "{}/[old] [/b]"], "{}/[old] [/b]"),
        (["--dataset", "folder", "--root", "{}/" + 400 * "9"], "no folder can have this name"),
    ],
)
def test_an_error_is_one_line(arguments, message, tmp_path, capsys):
    folder = str(tmp_path)
    out = tmp_path / "out"
    status = main(["map", *(a.replace("{}", folder) for a in arguments), "--out", str(out)])
    printed = capsys.readouterr()
    assert status == 1
    assert printed.out == ""
    assert printed.err.startswith("error: ")
    assert message.replace("{}", folder) in printed.err
    assert printed.err.count("\n") == 1
    assert "Traceback" not in printed.err
    assert not out.exists()


def test_an_unknown_scene_names_those_there_are(shared_data, tmp_path, capsys):
    status = main(
        ["map", "--dataset", "scannet", "--root", str(shared_data / "scannet"), "--scene", "scene9"]
        + ["--out", str(tmp_path / "out")]
    )
    printed = capsys.readouterr().err
    assert status == 1
    assert "no scene 'scene9'; available: scene0470_00" in printed
    assert printed.count("\n") == 1


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ([], ["map", "train", "convert-prior", "priors"]),
        (["map"], ["--dataset", "--out", "--root", "--scene", "--views", "Views of each object."]),
        (["map"], ["--categories", "--priors", "--config", "(default: 3)"]),
        (["convert-prior"], ["--source", "--category", "--out", "--checkpoint", "--canonical-scale"]),
        (["priors"], ["PATH", "--json"]),
        (["train"], ["--category"]),
    ],
)
def test_help_tells_what_there_is(arguments, words, capsys):
    with pytest.raises(SystemExit) as caught:
        main([*arguments, "--help"])
    assert caught.value.code == 0
    printed = capsys.readouterr().out
    for word in words:
        assert word in printed


@pytest.mark.parametrize(("arguments", "words"), [(["--help"], "next-view"), (["--version"], "objgraph 0.")])
def test_help_and_version_load_no_heavy_library(arguments, words):
    heavy = ("torch", "gtsam", "scipy", "open3d", "matplotlib", "numpy", "tyro", "rich")
    code = (
        "import sys\nfrom objgraph.cli import main\n"
        f"try:\n    main({arguments})\nexcept SystemExit as end:\n    assert end.code == 0\n"
        f"print('loaded:', [name for name in {heavy} if name in sys.modules])"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert words in result.stdout
    assert result.stdout.endswith("loaded: []\n")


@pytest.mark.parametrize(("arguments", "problem"), [(["fly"], "no verb 'fly'"), ([], "no verb given")])
def test_a_verb_that_there_is_not_is_one_line_that_names_those_there_are(arguments, problem, capsys):
    with pytest.raises(SystemExit) as caught:
        main(arguments)
    assert caught.value.code == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.startswith(f"objgraph: {problem}; there are map, report, ")
    assert printed.err.count("\n") == 1


def options_of(verb: str, flag: str, capsys) -> set[str]:
    with pytest.raises(SystemExit) as caught:
        main([verb, flag])
    assert caught.value.code == 0
    return set(re.findall(r"^[│ ]+(--[a-z][a-z0-9.-]*)", capsys.readouterr().out, flags=re.MULTILINE))


@pytest.mark.parametrize("verb", ["map", "train", "train-guess", "evaluate-prior"])
def test_a_help_has_what_a_user_turns_and_all_of_it_where_asked(verb, capsys):
    usual, every = options_of(verb, "--help", capsys), options_of(verb, "--help-all", capsys)
    assert 5 < len(usual) <= 20
    assert usual == {option for option in every if "." not in option}
    assert usual < every


@pytest.mark.parametrize("arguments", [[], ["fly"], ["map"], ["map", "--dataset", "sample", "--speed", "9"]])
def test_a_word_it_does_not_know_is_a_usage_error(arguments, capsys):
    with pytest.raises(SystemExit) as caught:
        main(arguments)
    assert caught.value.code not in (0, None)
    printed = capsys.readouterr()
    assert "Traceback" not in printed.out + printed.err


def test_priors_are_listed_for_people_and_for_programs(tmp_path, capsys):
    save_prior(fallback_prior("lamp"), tmp_path / "own" / "lamp.safetensors")
    (tmp_path / "own" / "junk.safetensors").write_bytes(b"junk")
    path = tmp_path / "list" / "priors.json"
    assert main(["priors", str(tmp_path / "own"), "--json", str(path)]) == 0
    printed = capsys.readouterr().out
    entries = {entry["category"]: entry for entry in json.loads(path.read_text())["priors"]}
    assert set(entries) == {*available_priors(), "lamp"}
    for category in entries:
        assert category in printed
    chair = entries["chair"]
    assert chair["shipped"]
    assert "armchair" in chair["aliases"]
    assert chair["bytes"] == (WEIGHTS / "chair.safetensors").stat().st_size
    assert chair["code_length"] == 64
    assert 0 < chair["heldout_chamfer"] < 0.05
    assert chair["training_shapes"] > 100
    lamp = entries["lamp"]
    assert not lamp["shipped"]
    assert (lamp["code_length"], lamp["network"], lamp["training_shapes"]) == (3, "superquadric", None)
    assert [item.name for item in path.parent.iterdir()] == ["priors.json"]


@pytest.mark.parametrize(
    "arguments",
    [
        ["priors", "{}/absent.safetensors"],
        ["convert-prior", "--source", "{}", "--category", "sofa", "--out", "{}/sofa.safetensors"],
        ["convert-prior", "--source", "{}", "--category", "sofa", "--out", "{}/sofa.pth"],
    ],
)
def test_a_prior_that_is_none_is_one_line(arguments, tmp_path, capsys):
    assert main([argument.replace("{}", str(tmp_path)) for argument in arguments]) == 1
    printed = capsys.readouterr().err
    assert printed.startswith("error: ")
    assert str(tmp_path) in printed
    assert printed.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_a_category_that_the_scan_has_not_is_named(shared_data, tmp_path, capsys):
    arguments = ["map", "--dataset", "scannet", "--root", str(shared_data / "scannet")]
    assert main([*arguments, "--categories", "zebra", "--out", str(tmp_path / "out")]) == 1
    printed = capsys.readouterr().err
    assert "scene0470_00 has no object of zebra; its categories: chair, table, trash_bin" in printed


def test_who_stops_it_is_told_what_is_kept(monkeypatch, capsys):
    def stopped(arguments, console):
        raise KeyboardInterrupt

    goes_on, whole = "the same command goes on from here", "nothing is half-written"
    for verb, kept in (("train", goes_on), ("map", whole), ("segment", whole)):
        monkeypatch.setitem(VERBS, verb, stopped)
        assert main([verb]) == 130
        assert capsys.readouterr().err == f"stopped; {kept}\n"


@pytest.mark.parametrize(("flag", "printed"), [("-q", ""), ("--quiet", ""), ("-v", "a table\n")])
def test_quiet_leaves_errors_alone(flag, printed, monkeypatch, capsys):
    def said(arguments, console):
        console.print("a table")
        raise ObjectGraphError("a fault")

    monkeypatch.setitem(VERBS, "map", said)
    assert main([flag, "map"]) == 1
    found = capsys.readouterr()
    assert (found.out, found.err) == (printed, "error: a fault\n")


@pytest.mark.parametrize(("columns", "width"), [("", 140), ("0", 140), ("wide", 140), ("60", 60)])
def test_the_width_is_what_columns_says_if_it_says_one(columns, width, monkeypatch):
    seen = []
    monkeypatch.setenv("COLUMNS", columns)
    monkeypatch.setitem(VERBS, "map", lambda _, console: seen.append(console.width))
    assert main(["map"]) == 0
    assert seen == [width]


def test_a_path_is_no_markup(tmp_path, capsys):
    path = tmp_path / "[red] [" / "x].json"
    assert main(["priors", "--json", str(path)]) == 0
    assert str(path) in capsys.readouterr().out.replace("\n", "")
    folder = tmp_path / "maps [" / "red]"
    ObjectMap("room", (MappedObject(1, "chair", "failed", "unseen"),), np.array([0.0, 0.0, 1.0])).save(folder)
    assert main(["report", str(folder)]) == 0
    assert str(folder) in capsys.readouterr().out


@pytest.mark.parametrize("number", [errno.EACCES, errno.EROFS, errno.ENOSPC, errno.EIO, errno.ENAMETOOLONG])
def test_a_path_that_the_system_refuses_is_one_line(number, monkeypatch, capsys):
    """As where a folder is another user's: which verb asks about it first is no matter."""

    def refused(arguments, console):
        raise OSError(number, os.strerror(number), "/data/[b] of another")

    monkeypatch.setitem(VERBS, "segment", refused)
    assert main(["segment"]) == 1
    printed = capsys.readouterr().err
    assert printed.startswith(f"error: [Errno {number}] {os.strerror(number)}: '/data/[b] of another'")
    assert printed.count("\n") == 1


def test_what_the_system_says_of_no_path_is_no_user_s_mistake(monkeypatch):
    def failed(arguments, console):
        raise OSError(errno.EBADF, os.strerror(errno.EBADF))

    monkeypatch.setitem(VERBS, "map", failed)
    with pytest.raises(OSError, match="Bad file descriptor"):
        main(["map"])


@pytest.mark.parametrize("encoding", ["ascii", "latin-1", "koi8-r", "utf-8"])
def test_a_letter_that_the_terminal_lacks_is_no_error(encoding, tmp_path):
    """Of a map's table, of a name, of a path: the work before it would be lost."""
    code = (
        "import sys\n"
        "from objgraph.cli.main import VERBS, main\n"
        "VERBS['map'] = lambda _, console: console.print('1.20±0.01 椅子 Stühle \\udcff')\n"
        "sys.exit(main(['map']))\n"
    )
    said = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, env=os.environ | {"PYTHONIOENCODING": encoding}
    )
    assert (said.returncode, said.stderr) == (0, b"")
    assert said.stdout == "1.20±0.01 椅子 Stühle \udcff\n".encode(encoding, "backslashreplace")


@pytest.mark.parametrize(
    "words",
    [
        ["priors", "--json", "{}/file/below"],
        ["priors", "{}/" + 400 * "9"],
        ["priors", "--json", "{}/" + 400 * "9"],
        ["evaluate-prior", "--category", "chair", "--meshes", "{}", "--json", "{}/" + 400 * "9"],
        ["report", "{}/" + 400 * "9"],
    ],
)
def test_a_place_that_cannot_be_is_one_line(words, tmp_path, capsys):
    (tmp_path / "file").touch()
    assert main([*(word.replace("{}", str(tmp_path)) for word in words)]) == 1
    assert capsys.readouterr().err.startswith("error: ")
    assert [path.name for path in tmp_path.iterdir()] == ["file"]
