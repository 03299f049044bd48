"""The command line: what the user can mend is one line and the status 1, never a traceback."""

import json

import pytest

from objgraph.cli.main import main
from objgraph.priors.fallback import fallback_prior
from objgraph.priors.registry import WEIGHTS, available_priors
from objgraph.priors.store import save_prior


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--dataset", "nope"], "data set 'nope': --root must name its folder"),
        (
            ["--dataset", "nope", "--root", "."],
            "no data set 'nope'; available: folder, sample, scannet, sevenscenes",
        ),
        (["--dataset", "scannet"], "data set 'scannet': --root must name its folder"),
        (["--dataset", "scannet", "--root", "{}/absent"], "{}/absent"),
        (["--dataset", "sevenscenes", "--root", "{}/absent"], "{}/absent"),
        (["--dataset", "scannet", "--root", "{}", "--scene", "scene9"], "scans"),
        (["--dataset", "sevenscenes", "--root", "{}", "--scan2cad", "."], "has no option scan2cad"),
        (["--dataset", "scannet", "--root", "{}/[old] [/b]"], "{}/[old] [/b]"),
    ],
)
def test_an_error_is_one_line(arguments, message, tmp_path, capsys):
    folder = str(tmp_path)
    out = tmp_path / "out"
    status = main(["map", *(a.replace("{}", folder) for a in arguments), "--out", str(out)])
    printed = capsys.readouterr()
    assert status == 1
    assert printed.out.startswith("error: ")
    assert message.replace("{}", folder) in printed.out
    assert printed.out.count("\n") == 1
    assert "Traceback" not in printed.out + printed.err
    assert not out.exists()


def test_an_unknown_scene_names_those_there_are(shared_data, tmp_path, capsys):
    status = main(
        ["map", "--dataset", "scannet", "--root", str(shared_data / "scannet"), "--scene", "scene9"]
        + ["--out", str(tmp_path / "out")]
    )
    printed = capsys.readouterr().out
    assert status == 1
    assert "no scene 'scene9'; available: scene0470_00" in printed
    assert printed.count("\n") == 1


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ([], ["map", "train", "convert-prior", "priors"]),
        (["map"], ["--dataset", "--out", "--root", "--scene", "--views", "Views of each object."]),
        (["map"], ["--categories", "--priors"]),
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


@pytest.mark.parametrize("arguments", [[], ["fly"], ["map"], ["map", "--dataset", "sample", "--speed", "9"]])
def test_a_word_it_does_not_know_is_a_usage_error(arguments, capsys):
    with pytest.raises(SystemExit) as caught:
        main(arguments)
    assert caught.value.code not in (0, None)
    printed = capsys.readouterr()
    assert "Traceback" not in printed.out + printed.err


def test_priors_are_listed_for_people_and_for_programs(tmp_path, capsys):
    save_prior(fallback_prior("sofa"), tmp_path / "own" / "sofa.safetensors")
    (tmp_path / "own" / "junk.safetensors").write_bytes(b"junk")
    path = tmp_path / "list" / "priors.json"
    assert main(["priors", str(tmp_path / "own"), "--json", str(path)]) == 0
    printed = capsys.readouterr().out
    entries = {entry["category"]: entry for entry in json.loads(path.read_text())["priors"]}
    assert set(entries) == {*available_priors(), "sofa"}
    for category in entries:
        assert category in printed
    chair = entries["chair"]
    assert chair["shipped"]
    assert "armchair" in chair["aliases"]
    assert chair["bytes"] == (WEIGHTS / "chair.safetensors").stat().st_size
    assert chair["code_length"] == 64
    assert 0 < chair["heldout_chamfer"] < 0.05
    assert chair["training_shapes"] > 100
    sofa = entries["sofa"]
    assert not sofa["shipped"]
    assert (sofa["code_length"], sofa["network"], sofa["training_shapes"]) == (3, "superquadric", None)
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
    printed = capsys.readouterr().out
    assert printed.startswith("error: ")
    assert str(tmp_path) in printed
    assert printed.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_a_category_that_the_scan_has_not_is_named(shared_data, tmp_path, capsys):
    arguments = ["map", "--dataset", "scannet", "--root", str(shared_data / "scannet")]
    assert main([*arguments, "--categories", "zebra", "--out", str(tmp_path / "out")]) == 1
    printed = capsys.readouterr().out
    assert "scene0470_00 has no object of zebra; its categories: chair, table, trash can" in printed
