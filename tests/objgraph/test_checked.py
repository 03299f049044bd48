"""What documents may hold, and what is refused before anything is made of it."""

import json
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from objgraph.checked import DEEPEST, direction, fits, inside, numbers, parse_json, typed, whole

JSON = st.recursive(
    st.none()
    | st.booleans()
    | st.integers(-(2**63), 2**63)
    | st.floats(allow_nan=False, allow_infinity=False)
    | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=10,
)


@given(JSON, st.sampled_from(["utf-8", "utf-8-sig", "utf-16"]))
def test_every_document_comes_back(document, encoding):
    assert parse_json(json.dumps(document, ensure_ascii=False).encode(encoding)) == document


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (b"", "Expecting value"),
        (b"{", "Expecting"),
        (b"\xff\xfe\xff", "decode"),
        (b"[1e400]", "not finite"),
        (b'[{"a": 1, "b": 2, "a": 1}]', "'a' is there twice"),
        (b"[NaN]", "not finite"),
        (b"[-Infinity]", "not finite"),
        (b"1" + b"0" * 400, "more than 64 bits"),
        (b"-" + b"9" * 20, "more than 64 bits"),
        (b"1" * 5000, "digits"),
        (b'"\\ud800"', "surrogates"),
        (b"[" * (DEEPEST + 1) + b"]" * (DEEPEST + 1), "nested"),
        (b'{"a":' * 200 + b"1" + b"}" * 200, "nested"),
        (b"[" * 100_000, "nested"),
    ],
)
def test_what_cannot_be_computed_with_or_written_is_refused(data, reason):
    with pytest.raises(ValueError, match=reason):
        parse_json(data)


def test_nan_and_infinity_are_read_where_they_are_asked_for():
    read = parse_json(b"[NaN, -Infinity, 1e400]", finite=False)
    np.testing.assert_array_equal(read, [np.nan, -np.inf, np.inf])


@pytest.mark.parametrize(("value", "number"), [(3, 3), (3.0, 3), ("3", 3), (" -7 ", -7), (2**60, 2**60)])
def test_whole_numbers(value, number):
    assert whole(value) == number


@pytest.mark.parametrize("value", [1.5, float("nan"), float("inf"), True, None, "x", "1.5", [], "9" * 5000])
def test_what_is_no_whole_number(value):
    with pytest.raises(ValueError, match=r"whole number|invalid literal|digits"):
        whole(value)


def test_a_number_that_no_float_holds_is_none():
    with pytest.raises(ValueError, match="no numbers"):
        numbers([10**400], 1)


def test_numbers_have_a_shape():
    np.testing.assert_array_equal(numbers([1, 2, 3, 4], 2, 2), [[1, 2], [3, 4]])
    np.testing.assert_array_equal(numbers(2.5, 1), [2.5])


@pytest.mark.parametrize(
    "value", [None, [1, 2], [1, 2, None], [1, 2, "x"], {"a": 1}, [[1], [2, 3]], [1, 2, np.inf], "abc"]
)
def test_what_is_no_array_of_three_numbers(value):
    with pytest.raises(ValueError, match=r"number|float|sequence"):
        numbers(value, 3)


@given(st.lists(st.floats(-1e308, 1e308), min_size=3, max_size=3).filter(any))
def test_every_direction_is_of_length_one(vector):
    assert abs(np.linalg.norm(direction(vector, "up")) - 1) < 1e-6


@pytest.mark.parametrize("vector", [[0, 0, 0], [0, 1], None, [0, 0, float("nan")]])
def test_what_is_no_direction_is_named(vector):
    with pytest.raises(ValueError, match="up_world must be three numbers"):
        direction(vector, "up_world")


@pytest.mark.parametrize("name", ["a.png", "b/a.png", "b/../a.png", "./a.png", "link_within/a.png"])
def test_a_file_in_the_folder(tmp_path, name):
    (tmp_path / "b").mkdir()
    (tmp_path / "link_within").symlink_to(tmp_path / "b")
    assert inside(tmp_path, name) == tmp_path / name


def test_backslashes_part_folders_unless_a_file_has_them_in_its_name(tmp_path):
    assert inside(tmp_path, ".\\b\\a.png") == tmp_path / "b" / "a.png"
    (tmp_path / "b\\a.png").touch()
    assert inside(tmp_path, "b\\a.png") == tmp_path / "b\\a.png"


@pytest.mark.parametrize(
    "name",
    [
        "../a",
        "/a",
        "b/../../a",
        "..\\a",
        "b\\..\\..\\a",
        "link\\a",
        "link/a",
        "round",
        "",
        None,
        3,
        "a\0b",
        "x" * 5000,
    ],
)
def test_a_file_that_is_not_in_the_folder(tmp_path, name):
    folder = tmp_path / "own"
    folder.mkdir()
    (folder / "link").symlink_to(tmp_path)
    (folder / "round").symlink_to(folder / "round")
    with pytest.raises(ValueError, match=r"lies outside of|is no file's name"):
        inside(folder, name)


@dataclass(frozen=True)
class Entry:
    name: str
    count: int = 0
    share: float | None = None
    kind: Literal["a", "b"] = "a"
    codes: tuple[float, ...] = ()
    table: list[list[float]] | None = None
    more: dict[str, Any] | None = None


@pytest.mark.parametrize(
    "given",
    [
        {"name": "x"},
        {"name": "x", "count": 3, "share": 1, "kind": "b", "codes": (1, 2.5)},
        {"name": "x", "table": [[1.0], []], "more": {"a": [1]}, "share": None},
    ],
)
def test_values_of_their_types_are_taken(given):
    assert typed(Entry, given) == Entry(**given)


@pytest.mark.parametrize(
    "given",
    [
        {}, {"name": None}, {"name": "x", "other": 1}, {"name": "x", "count": 1.5}, {"name": "x", "count": True},
        {"name": "x", "share": "1"}, {"name": "x", "kind": "c"}, {"name": "x", "kind": []}, {"name": "x", "codes": [1.0]},
        {"name": "x", "codes": (None,)}, {"name": "x", "table": [1.0]}, {"name": "x", "more": []}, None, [], "name",
    ],
)  # fmt: skip
def test_values_of_other_types_are_refused(given):
    with pytest.raises(TypeError):
        typed(Entry, given)


def test_anything_is_any():
    assert fits(object(), Any)
