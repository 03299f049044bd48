"""How many views one policy saves another."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from objgraph.bench.views_needed import (
    bootstrap,
    mean_errors,
    objects_of,
    seen_by_all,
    views_needed,
    views_to_reach,
    within,
)


def rows_of(name: str, policy: str, errors: list[float]) -> list[dict]:
    return [
        {"object": name, "policy": policy, "views": i + 1, "error": error} for i, error in enumerate(errors)
    ]


ROWS = [
    *rows_of("a", "best", [8.0, 4.0]), *rows_of("a", "any", [8.0, 7.0, 3.0, 9.0]),
    *rows_of("b", "best", [6.0, 2.0]), *rows_of("b", "any", [6.0, 5.0, 1.0, 9.0]),
]  # fmt: skip


def test_chance_needs_more_views_for_the_same_mean_error():
    """Three after two views of the best, with means of 7, 6 and 2 for chance: three quarters of the way from two to three."""
    assert mean_errors(ROWS, "best", "error") == {1: 7.0, 2: 3.0}
    assert mean_errors(ROWS, "any", "error") == {1: 7.0, 2: 6.0, 3: 2.0, 4: 9.0}
    assert views_needed(ROWS, "best", 2, ["any"], "error") == {"any": (2.75, True)}
    assert views_needed(ROWS, "best", 1, ["any"], "error") == {"any": (1.0, True)}


def test_who_never_gets_there_needs_all_and_more():
    assert views_to_reach({1: 5.0, 2: 4.0, 3: 3.0}, 2.9) == (3.0, False)
    assert views_to_reach({}, 2.9) == (None, False)
    assert views_needed([], "best", 2, ["any"], "error") == {"any": (None, False)}
    assert views_needed(ROWS, "best", 3, ["any"], "error") == {"any": (4.0, False)}  # which nobody has


def test_the_interval_is_of_objects_drawn_anew():
    """Alone the first object gets there with two views and the second with four, both together with three."""
    rows = [
        *rows_of("a", "best", [8.0, 4.0]), *rows_of("a", "any", [8.0, 4.0, 2.0, 1.0]),
        *rows_of("b", "best", [8.0, 2.0]), *rows_of("b", "any", [8.0, 5.0, 4.0, 2.0]),
    ]  # fmt: skip
    assert views_needed(rows, "best", 2, ["any"], "error") == {"any": (3.0, True)}
    assert bootstrap(rows, "best", 2, ["any"], "error") == {"any": (2.0, 4.0)}
    assert bootstrap([], "best", 2, ["any"], "error") == {}


@given(st.lists(st.floats(0.1, 10), min_size=1, max_size=8), st.floats(0.05, 11))
def test_the_error_between_whole_views_is_the_goal(errors, goal):
    count, reached = views_to_reach(dict(enumerate(errors, 1)), goal)
    assert count is not None
    assert reached == (min(errors) <= goal)
    assert 1 <= count <= len(errors)
    whole = np.arange(1, len(errors) + 1)
    if reached and count > 1:
        assert np.interp(count, whole, errors) == pytest.approx(goal)
        assert (np.array(errors)[whole < count - 1e-9] > goal - 1e-9).all()


def test_objects_that_a_policy_has_seen_less_often_do_not_count():
    fewer = [row for row in ROWS if (row["object"], row["policy"], row["views"]) != ("b", "any", 4)]
    assert objects_of(seen_by_all(fewer, {"best": 2, "any": 4})) == {"a"}
    assert seen_by_all(fewer, {"best": 2, "any": 3}) == fewer
    assert mean_errors(fewer, "any", "error") == {1: 7.0, 2: 6.0, 3: 2.0}


def test_objects_that_were_once_beyond_the_limit_do_not_count():
    assert objects_of(within(ROWS, "error", 9.0)) == {"a", "b"}
    assert objects_of(within(rows_of("c", "any", [1.0, 9.1]) + ROWS, "error", 9.0)) == {"a", "b"}
    assert within(ROWS, "error", 8.5) == []
