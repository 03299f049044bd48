"""What a caller gives is taken cleaned, or refused by a typed error that names it."""

from dataclasses import dataclass, field
from typing import Any, Literal

import gtsam
import numpy as np
import pytest
import torch
from gtsam.symbol_shorthand import X

from factors import checks
from factors.code_mixture import CodeMixture
from factors.depth import RaySampling
from factors.errors import FactorError
from factors.full_distribution import FullDistribution
from factors.priors import code_prior, placed_prior, scale_prior, upright_prior
from factors.state import ObjectKeys, ObjectState

KEYS = ObjectKeys.numbered(0)


def other(value: Any) -> Any:
    """Of another type than is declared."""
    return value


@dataclass(frozen=True)
class Settings:
    count: int = 3
    share: float | None = 0.5
    kind: Literal["a", "b"] = "a"
    slopes: tuple[float, ...] = (1.0,)
    flag: bool = False
    inner: RaySampling = field(default_factory=RaySampling)

    def __post_init__(self) -> None:
        checks.settings(self, share=checks.Range(0, 1), slopes=checks.POSITIVE)


@pytest.mark.parametrize(
    "given",
    [{}, {"share": None}, {"count": np.int64(4)}, {"share": 1}, {"slopes": ()}, {"flag": np.True_}],
)
def test_settings_that_will_do(given):
    Settings(**given)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"count": -1}, "Settings.count must be at least 0, not -1"),
        ({"count": 2.0}, "Settings.count must be a whole number, not 2.0"),
        ({"count": True}, "Settings.count must be a whole number"),
        ({"share": 1.5}, "Settings.share must be at least 0 and at most 1"),
        ({"share": np.nan}, "Settings.share must be"),
        ({"share": "half"}, "Settings.share must be a number, not 'half'"),
        ({"kind": "c"}, "Settings.kind must be one of a, b, not 'c'"),
        ({"kind": np.zeros(2)}, "Settings.kind must be one of"),
        ({"slopes": (1.0, 0.0)}, r"Settings.slopes\[1\] must be more than 0, not 0.0"),
        ({"slopes": 1.0}, "Settings.slopes must be of type tuple"),
        ({"flag": 1}, "Settings.flag must be of type bool"),
        ({"inner": None}, "Settings.inner must be of type RaySampling, not NoneType"),
    ],
)
def test_settings_that_are_none_are_named(given, message):
    with pytest.raises(FactorError, match=message):
        Settings(**given)


@pytest.mark.parametrize(
    "make",
    [
        lambda: checks.array("it", [[1.0, 2.0], [3.0]], None),
        lambda: checks.array("it", torch.zeros(3, requires_grad=True), (3,)),
        lambda: checks.array("it", np.array(["1"]), (1,)),
        lambda: checks.array("it", [10**400], (1,)),
        lambda: checks.array("it", np.zeros(3), (None, 3)),
        lambda: checks.reals("it", [np.inf], (1,)),
        lambda: checks.direction("it", [0.0, 0.0, 0.0]),
        lambda: checks.pose("it", gtsam.Pose3(gtsam.Rot3(), np.array([np.nan, 0, 0]))),
        lambda: checks.key("it", -1),
        lambda: checks.keys("it", "o0"),
        lambda: checks.covariance("it", np.array([[1.0, 2.0], [2.0, 1.0]]), 2),
        lambda: checks.tuple_of("it", "abc", str),
    ],
)
def test_what_is_none_of_its_kind_is_named(make):
    with pytest.raises(FactorError, match=r"\bit\b"):
        make()


def test_arrays_of_any_layout_and_tensors_are_taken():
    array = np.asfortranarray(np.arange(6.0).reshape(2, 3))[::-1]
    array.flags.writeable = False
    np.testing.assert_array_equal(checks.reals("it", array, (2, 3)), array)
    np.testing.assert_array_equal(checks.reals("it", torch.arange(3), (3,)), [0.0, 1.0, 2.0])
    assert checks.direction("it", [0, 0, 2]).tolist() == [0.0, 0.0, 1.0]


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: code_prior(KEYS, np.zeros(2), -np.eye(2)), "covariance is not positive definite"),
        (lambda: code_prior(KEYS, np.zeros(2), np.eye(3)), "covariance has shape"),
        (lambda: scale_prior(KEYS, 0.0, 0.0, 0.1), "size_sigma must be"),
        (lambda: upright_prior(KEYS, np.zeros(3), 0.1), "up_world must have a direction"),
        (lambda: placed_prior(KEYS, other("here"), 0.1, 0.1, 0.1), "T_world_object must be of type Pose3"),
        (lambda: CodeMixture(*other(([0.5, 0.5], [0.0, 1.0], [1.0, 1.0]))), "a mixture's mean has shape"),
        (lambda: checks.shares("a share", other("all"), 3), "a share is an array of"),
        (lambda: checks.shares("a share", 1.5, 3), "every entry of a share must be at least 0 and at most 1"),
        (lambda: checks.shares("a share", [0.5, 0.5], 3), "one number or 3 are due"),
        (lambda: RaySampling(cells=2**31), "RaySampling.cells must be at least 2 and at most 500"),
        (lambda: FullDistribution(other("none")), "FullDistribution.reach must be a number"),
        (lambda: ObjectKeys(1, 1, 2), "three different ones"),
        (lambda: ObjectKeys(1, 2, -3), "ObjectKeys.code must be a key"),
        (lambda: ObjectState(gtsam.Pose3(), np.zeros(2), np.zeros(4)), "ObjectState.log_scale has shape"),
        (lambda: ObjectState.from_values(gtsam.Values(), KEYS), "no object at o0, s0, z0"),
    ],
)
def test_what_makes_no_factor_is_named(make, message):
    with pytest.raises(FactorError, match=message):
        make()


def test_keys_are_a_list_of_whole_numbers_of_64_bits():
    assert checks.keys("keys", [X(1), np.int64(2), 2**64 - 1, 0]) == [X(1), 2, 2**64 - 1, 0]
    for wrong, words in [
        ("x1", "a list"),
        (3, "a list"),
        ([2**64], r"keys\[0\]"),
        ([1, -1], r"keys\[1\]"),
        ([1, 0.5], "key"),
    ]:
        with pytest.raises(FactorError, match=words):
            checks.keys("keys", wrong)


def test_what_is_refused_is_shown_by_its_first_line():
    with pytest.raises(FactorError, match=r"not array\(\[\[1., 1.\],$"):
        checks.number("a number", np.ones((2, 2)))
