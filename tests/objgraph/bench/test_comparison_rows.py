"""The rows' file: a kill at any byte loses a line at most, and what is damaged is told."""

import json
from dataclasses import asdict

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from objgraph.bench.comparison.objects.rows import ObjectRow, csv_text
from objgraph.bench.comparison.running.store import RowFile, plain
from objgraph.errors import EvaluationError
from tests.objgraph.bench.comparison_fakes import row

ROWS = [
    row("near", "chair-0", 1, pearson=0.5, code=[0.1, 0.2], covariance=[[1.0, 0.0], [0.0, 1.0]]),
    row("near", "chair-1", 2, failure="no \u00e4rger, no\nchair", shape="a,b"),
    row("far", "chair-0", 3, chamfer_m=0.01),
]
DATA = b"".join(json.dumps(asdict(each)).encode() + b"\n" for each in ROWS)


@given(st.integers(0, len(DATA)))
def test_rows_survive_a_kill_at_any_byte(tmp_path_factory, cut):
    path = tmp_path_factory.mktemp("cut") / "objects.jsonl"
    path.write_bytes(DATA[:cut])
    whole = DATA[:cut].count(b"\n")
    with RowFile(path, ObjectRow) as file:
        assert file.rows == ROWS[:whole]
        for each in ROWS[whole:]:
            file.append(each)
    assert path.read_bytes() == DATA
    with RowFile(path, ObjectRow) as file:
        assert file.rows == ROWS


def test_a_row_is_in_the_file_before_it_is_closed(tmp_path):
    with RowFile(tmp_path / "new" / "objects.jsonl", ObjectRow) as file:
        file.append(ROWS[0])
        assert (tmp_path / "new" / "objects.jsonl").read_bytes().count(b"\n") == 1


@pytest.mark.parametrize("line", [b"{]\n", b'{"method": "near"}\n', b"[1]\n", b"\xff\xfe\n"])
def test_a_damaged_line_is_named(tmp_path, line):
    path = tmp_path / "objects.jsonl"
    path.write_bytes(DATA + line + DATA)
    with pytest.raises(EvaluationError, match=r"objects.jsonl, line 4: damaged"):
        RowFile(path, ObjectRow)
    path.write_bytes(DATA)  # and the lock is given back
    with RowFile(path, ObjectRow) as file:
        assert len(file.rows) == 3


def test_two_runs_do_not_write_to_one_file(tmp_path):
    with (
        RowFile(tmp_path / "objects.jsonl", ObjectRow),
        pytest.raises(EvaluationError, match="another run is writing"),
    ):
        RowFile(tmp_path / "objects.jsonl", ObjectRow)
    with RowFile(tmp_path / "objects.jsonl", ObjectRow):
        pass


def test_a_folder_that_is_none_is_a_typed_error(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(EvaluationError, match="cannot be written"):
        RowFile(tmp_path / "file" / "objects.jsonl", ObjectRow)


def test_csv_has_the_single_values(tmp_path):
    header, *lines = csv_text(ROWS[::2]).splitlines()
    names = header.split(",")
    assert not {"code", "covariance", "surface_error", "T_world_object", "truth_scale"} & set(names)
    assert {"method", "case", "views", "failure", "chamfer_m", "seconds", "frames", "shape"} <= set(names)
    first = dict(zip(names, lines[0].split(","), strict=True))
    assert (first["method"], first["pearson"], first["chamfer_m"]) == ("near", "0.5", "")
    assert len(lines) == 2


def test_plain_values_are_json(tmp_path):
    assert plain(np.array([[1.0, np.nan], [np.inf, 2.0]])) == [[1.0, None], [None, 2.0]]
    assert plain(float("nan")) is None
    assert plain(np.float64(2.5)) == 2.5
    assert plain(np.array([True])) == [True]
    assert ObjectRow(**json.loads(DATA.splitlines()[0])) == ROWS[0]
