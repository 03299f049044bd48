"""The map and its objects: what they refuse."""

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from objgraph.errors import MapError
from objgraph.maps.mapped_object import MappedObject
from objgraph.maps.object_map import ObjectMap
from objgraph.maps.other_estimate import OtherEstimate
from tests.objgraph.maps.map_cases import UP, failed, mapped, other

finite = st.floats(-1e6, 1e6)


def test_arrays_are_read_only_double_copies():
    code = np.ones(8, np.float32)
    entry = mapped(code=code)
    code[0] = 7
    assert entry.code is not None
    assert entry.faces is not None
    assert entry.code.dtype == np.float64
    assert entry.code[0] == 1
    with pytest.raises(ValueError, match="read-only"):
        entry.code[0] = 2
    with pytest.raises(ValueError, match="read-only"):
        entry.faces[0] = 2


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        ({"T_world_object": np.diag([2.0, 2, 2, 1])}, "T_world_object is no rigid"),
        ({"T_world_object": np.eye(3)}, r"T_world_object has shape \(3, 3\)"),
        ({"scale": [1, -1, 1]}, "scale must be positive"),
        ({"code": None}, "code is missing"),
        ({"code": [np.nan] * 8}, "code has entries that are not finite"),
        ({"covariance": -np.eye(9)}, "covariance has a negative variance"),
        ({"covariance": np.full((9, 9), np.inf)}, "covariance has entries that are not finite"),
        ({"code_sigma": np.ones(3)}, "code_sigma has 3 entries"),
        ({"code_sigma": -np.ones(8), "joint_covariance": None}, "code_sigma has a negative entry"),
        ({"vertex_sigma": -np.ones(3)}, "vertex_sigma has a negative entry"),
        ({"cost_final": float("nan")}, "cost_final must be finite, not nan"),
        ({"seconds_by_stage": {"solve": float("inf")}}, "seconds_by_stage.solve must be finite, not inf"),
        ({"linearizations": 1.5}, "linearizations must be a whole number, not 1.5"),
        ({"cameras": np.eye(4)[None]}, "cameras are 1, for 2 views"),
        ({"cameras": np.zeros((2, 4, 4))}, "cameras are no rigid transforms"),
        ({"turned": np.zeros((4, 12))}, r"turned has shape \(4, 12\), not 4 x 17"),
        ({"turned": np.zeros((3, 17))}, r"turned has shape \(3, 17\)"),
        ({"turns": None}, "turned is given without turns"),
        ({"scale": [1, 1j, 1]}, "scale is an array of complex128"),
        ({"code": ["1"] * 8}, "code is an array of <U1"),
        ({"faces": [[0.5, 1, 2]]}, "faces is an array of float64; its entries must be whole"),
        ({"seconds": "1"}, "seconds must be a number, not '1'"),
        ({"status": "lost"}, "status is 'lost'"),
        ({"status": "failed"}, "reason must say why"),
        ({"faces": None}, "faces is missing"),
        ({"faces": [[0, 1, 4000]]}, "faces is empty or names vertices outside"),
        ({"vertex_sigma": np.ones(2)}, "vertex_sigma has 2 entries"),
        ({"joint_covariance": np.eye(12)}, r"joint_covariance has shape \(12, 12\), not 17 x 17"),
        ({"joint_covariance": np.eye(17)}, "joint_covariance contradicts"),
        ({"joint_covariance": -np.eye(17)}, "joint_covariance is none: .*negative variance"),
        ({"joint_covariance": np.triu(np.ones((17, 17)))}, "joint_covariance is none: .*not symmetric"),
    ],
)
def test_what_cannot_be_is_refused_with_object_and_field(changes, complaint):
    with pytest.raises(MapError, match=rf"object 7 \(chair\): {complaint}"):
        mapped(7, **changes)


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        ({"estimator": None}, "estimator"),
        ({"T_world_object": None}, "T_world_object is missing"),
        ({"scale": None}, "scale is missing"),
        ({"code": None}, "code is missing"),
        ({"covariance": None}, "covariance is missing"),
        ({"code_sigma": None}, "code_sigma is missing"),
        ({"T_world_object": np.eye(3)}, "T_world_object has shape"),
        ({"T_world_object": np.diag([2.0, 2, 2, 1])}, "the pose must be rigid"),
        ({"T_world_object": np.diag([1.0, 1, -1, 1])}, "the pose must be rigid"),
        ({"scale": [1, 0, 1]}, "scale positive"),
        ({"scale": "x"}, "scale is an array of <U1"),
        ({"code": np.ones((2, 4))}, "code has shape"),
        ({"covariance": np.eye(8)}, "covariance has shape"),
        ({"covariance": np.diag([1.0] * 8 + [-1e-3])}, "covariance"),
        ({"code_sigma": np.ones(3)}, "code_sigma"),
    ],
)
def test_another_estimate_that_cannot_be_is_refused(changes, complaint):
    with pytest.raises(MapError, match=f"other estimate.*{complaint}"):
        other(**changes)


@given(
    name=st.sampled_from(["T_world_object", "scale", "code", "covariance", "code_sigma"]),
    value=st.sampled_from([np.nan, np.inf, -np.inf]),
    where=st.integers(0, 80),
)
def test_another_estimate_is_finite(name, value, where):
    array = np.array(getattr(other(), name))
    array.flat[where % array.size] = value
    with pytest.raises(MapError, match=f"other estimate: {name} has entries that are not finite"):
        other(0, **{name: array})


@given(st.integers(0, 2**31))
def test_another_estimate_comes_back_from_its_json(seed):
    one = other(seed)
    again = OtherEstimate.from_json(json.loads(json.dumps(one.to_json())))
    assert again == one
    for name in ("T_world_object", "scale", "code", "covariance", "code_sigma"):
        np.testing.assert_array_equal(getattr(again, name), getattr(one, name))
        assert not getattr(again, name).flags.writeable
    assert one != other(seed, estimator="graph")
    assert one != other(seed, code=one.code + 1e-9)
    assert one != one.to_json()


@pytest.mark.parametrize(
    "document",
    [None, 3, [], {}, {"estimator": "adam"}, other().to_json() | {"more": 1}],
)
def test_json_of_another_estimate_has_its_names_and_no_more(document):
    with pytest.raises(MapError, match="other estimate must have estimator, T_world_object, scale, code"):
        OtherEstimate.from_json(document)


def test_ids_are_unique_and_up_is_a_unit_vector():
    with pytest.raises(MapError, match=r"id \[1\]"):
        ObjectMap("room", (mapped(1), failed(1)), UP)
    with pytest.raises(MapError, match="up_world"):
        ObjectMap("room", (), np.array([0, 0, 2.0]))


def test_a_mapped_object_gives_its_state_and_its_labelled_covariance():
    entry = mapped(4)
    assert entry.scale is not None
    np.testing.assert_allclose(entry.state.scale, entry.scale)
    np.testing.assert_array_equal(entry.state.T_world_object.matrix(), entry.T_world_object)
    covariance = entry.uncertainty
    np.testing.assert_array_equal(covariance.matrix, entry.joint_covariance)
    assert (covariance.source, covariance.subject) == ("marginals", "chair 4")
    with pytest.raises(MapError, match=r"object 4 \(chair\) has no joint covariance"):
        _ = mapped(4, joint_covariance=None).uncertainty
    with pytest.raises(MapError, match=r"object 9 \(table\) is not mapped: seen in 12 pixels"):
        _ = failed().state


NOT_UNICODE = "Stra\udcdfe"
"""A file's name of bytes that are no UTF-8, as Python reads it."""
RENAME = "is no Unicode text; rename it"


def test_a_reason_and_a_number_are_kept_as_files_can_hold_them(tmp_path):
    entry = MappedObject(2**53 + 1, "chair", "failed", f"{NOT_UNICODE}: no such file")
    ObjectMap("room", (entry,), UP).save(tmp_path)
    (back,) = ObjectMap.load(tmp_path).objects
    assert (back.id, back.reason) == (2**53 + 1, "Stra?e: no such file")


def typed(value: Any) -> Any:
    """Of another type than is declared."""
    return value


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            lambda: ObjectMap("room", typed(("chair",)), UP),
            r"map of room: objects\[0\] must be of type MappedObject",
        ),
        (lambda: ObjectMap("room", typed(None), UP), "map of room: objects must be a list"),
        (lambda: ObjectMap("room", (), typed("up")), "map of room: up_world"),
        (lambda: ObjectMap(typed(7), (), UP), "the scene of a map must be of type str"),
        (lambda: ObjectMap.load(typed(7)), "must be a path"),
        (lambda: mapped(1, seconds_by_stage=None), "seconds_by_stage a dictionary"),
        (lambda: MappedObject(1, "chair", typed(np.zeros(0)), "why"), "status is no text"),
        (lambda: MappedObject(1, "chair", "failed", typed(np.zeros(0))), "reason is no text"),
        (lambda: MappedObject(1, "chair", "failed", "why", views=typed(7)), "views must be a list"),
        (lambda: mapped(1, scale=torch.ones(3, requires_grad=True)), "scale is no array of numbers"),
        (lambda: mapped(1, scale=[10**400] * 3), "scale is an array of object"),
        (lambda: mapped(2**64), "id must be .* and at most 1.84467e[+]19, not 18446744073709551616"),
        (lambda: ObjectMap(NOT_UNICODE, (), UP), rf"the scene of a map 'Stra\\udcdfe' {RENAME}"),
        (lambda: mapped(4, category=NOT_UNICODE), rf"object 4: category 'Stra\\udcdfe' {RENAME}"),
        (lambda: mapped(4, views=("0", NOT_UNICODE)), rf"object 4: view 'Stra\\udcdfe' {RENAME}"),
    ],
)
def test_what_is_no_part_of_a_map_is_named(make, message):
    with pytest.raises(MapError, match=message):
        make()


@pytest.mark.parametrize(
    ("kilometres", "is_told"), [(0.0, False), (16.0, False), (17.0, True), (500.0, True)]
)
def test_a_mesh_that_loses_more_than_a_millimetre_is_told_of(tmp_path, caplog, kilometres, is_told):
    entry = mapped()
    assert entry.vertices is not None
    far = replace(entry, vertices=entry.vertices + [0.0, -1000 * kilometres, 0.0])
    assert far.vertices is not None
    ObjectMap("s", (far,), UP).save(tmp_path)
    assert ("chair 1" in caplog.text and "move the origin" in caplog.text) == is_told
    (found,) = ObjectMap.load(tmp_path).objects
    assert found.vertices is not None
    lost = np.abs(found.vertices - far.vertices).max()
    assert is_told or lost < 1e-3
