"""The command line: what the user can mend is one line and the status 1, never a traceback."""

import pytest

from objgraph.cli import main


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--dataset", "nope"], "data set 'nope': --root must name its folder"),
        (["--dataset", "nope", "--root", "."], "no data set 'nope'; available: sample, scannet, sevenscenes"),
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
        ([], ["map", "train"]),
        (["map"], ["--dataset", "--out", "--root", "--scene", "--views", "Views of each object."]),
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
