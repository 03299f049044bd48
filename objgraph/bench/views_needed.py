"""How many views one policy of looking saves another, from the errors of both after every view.

Rows are of one object after so many views of one policy: `{"object": name, "policy": name, "views": count, measure: error}`.
"""

import itertools
from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np

Row = Mapping[str, Any]


def objects_of(rows: Sequence[Row]) -> set[str]:
    return {row["object"] for row in rows}


def seen_by_all(rows: Sequence[Row], most: Mapping[str, int]) -> list[Row]:
    """The rows of objects that every policy has seen 1, 2, ... `most[policy]` times."""
    wanted = {(policy, count) for policy, last in most.items() for count in range(1, last + 1)}
    had: dict[str, set[tuple[str, int]]] = {}
    for row in rows:
        had.setdefault(row["object"], set()).add((row["policy"], row["views"]))
    return [row for row in rows if had[row["object"]] >= wanted]


def within(rows: Sequence[Row], measure: str, limit: float) -> list[Row]:
    """The rows of objects whose error is never larger than the limit, whatever the policy and the number of views."""
    beyond = {row["object"] for row in rows if row[measure] > limit}
    return [row for row in rows if row["object"] not in beyond]


def mean_errors(rows: Sequence[Row], policy: str, measure: str) -> dict[int, float]:
    """Mean error by number of views, for every number that all objects were seen in."""
    objects = objects_of(rows)
    found: dict[int, dict[str, float]] = {}
    for row in rows:
        if row["policy"] == policy:
            found.setdefault(row["views"], {})[row["object"]] = row[measure]
    return {n: float(np.mean(list(found[n].values()))) for n in sorted(found) if set(found[n]) == objects}


def views_to_reach(errors: Mapping[int, float], goal: float) -> tuple[float | None, bool]:
    """Number of views at which the error first is as small as the goal, linearly between whole ones.

    The largest number there is, and False, where it never is; None where there are no errors.
    """
    counts = sorted(errors)
    if not counts:
        return None, False
    if errors[counts[0]] <= goal:
        return float(counts[0]), True
    for before, after in itertools.pairwise(counts):
        if errors[after] <= goal:
            share = (errors[before] - goal) / (errors[before] - errors[after])
            return before + (after - before) * share, True
    return float(counts[-1]), False


def views_needed(
    rows: Sequence[Row], policy: str, views: int, others: Collection[str], measure: str
) -> dict[str, tuple[float | None, bool]]:
    """For each of the others: views until its mean error is what the policy's is after `views`, and whether it gets there."""
    goal = mean_errors(rows, policy, measure).get(views, -np.inf)
    return {other: views_to_reach(mean_errors(rows, other, measure), goal) for other in others}


def bootstrap(
    rows: Sequence[Row], policy: str, views: int, others: Collection[str], measure: str, draws: int = 2000
) -> dict[str, tuple[float, float]]:
    """95 % of what `views_needed` gives when objects are drawn anew; an end at the largest number may be above it."""
    objects = sorted(objects_of(rows))
    if not objects:
        return {}
    names = (policy, *others)
    errors = {(row["object"], row["policy"], row["views"]): row[measure] for row in rows}
    counts = {name: sorted({n for _, whose, n in errors if whose == name}) for name in names}
    table = {
        name: np.array([[errors[one, name, n] for n in counts[name]] for one in objects]) for name in names
    }
    rng, found = np.random.default_rng(0), []
    for _ in range(draws):
        drawn = rng.integers(len(objects), size=len(objects))
        mean = {name: dict(zip(counts[name], table[name][drawn].mean(axis=0), strict=True)) for name in names}
        found.append([views_to_reach(mean[name], mean[policy][views])[0] for name in others])
    low, high = np.percentile(found, [2.5, 97.5], axis=0)
    return {name: (float(low[i]), float(high[i])) for i, name in enumerate(others)}
