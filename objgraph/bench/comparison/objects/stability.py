"""How far an estimate is the same again: the same objects by other draws of points and rays, and with two threads."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import groupby, product
from operator import attrgetter
from typing import Any

import numpy as np

from objgraph.bench.comparison.objects.compare import Comparison, compare
from objgraph.bench.comparison.objects.rows import ObjectRow
from objgraph.bench.comparison.running.store import Tell
from objgraph.work import HERE, Workers

SEEDS = 5
"""Of sampling, with one thread; the first of them once more with two."""
MODE_DEG = 45.0
"""Headings farther apart, modulo symmetry, are of different modes."""
LOST = 0.1
"""Recall of the true surface within 2 cm that is lower by as much has lost a part, as legs."""

MEASURED = (
    "stability: the same objects by 5 seeds of sampling with 1 thread and one of them with 2; spread_m, spread_deg (heading, modulo "
    "symmetry), spread_extents_m, spread_chamfer_m: root mean square about an object's mean, median of the n objects that never fail; "
    "mode_changes: share of objects with headings more than 45 degrees apart, or recall within 2 cm lower by 0.1; threads_m: between 1 "
    "and 2 threads, the largest of the n"
)


def compare_again(
    comparison: Comparison, workers: Workers = HERE, version: str = "", tell: Tell | None = None
) -> list[list[ObjectRow]]:
    """The rows of every run, in folders of their own under the comparison's. Raises as `compare` does."""
    runs = [(k, 1) for k in range(SEEDS)] + [(0, 2)]
    found = []
    for k, threads in runs:
        config = replace(comparison.config, seed=comparison.config.seed + k, threads=threads)
        folder = comparison.out / f"again-{k}-{threads}"
        found.append(compare(replace(comparison, out=folder, config=config), workers, False, version, tell))
    return found


def stability(runs: Sequence[Sequence[ObjectRow]]) -> list[dict[str, Any]]:
    """One entry a contender, category and number of views."""
    of = attrgetter("category", "views", "contender")
    objects = list(zip(*runs, strict=True))
    objects.sort(key=lambda rows: of(rows[0]))
    return [_entry(*group, [*chosen]) for group, chosen in groupby(objects, key=lambda rows: of(rows[0]))]


def _entry(
    category: str, views: int, contender: str, objects: Sequence[Sequence[ObjectRow]]
) -> dict[str, Any]:
    whole = [rows for rows in objects if all(row.failure is None for row in rows)]
    first = objects[0][0]
    spreads = {
        "spread_m": [_rms([row.centre_world for row in rows]) for rows in whole],
        "spread_deg": [_rms(np.degrees(_headings(rows))[:, None]) for rows in whole],
        "spread_extents_m": [_rms([row.extents for row in rows]) for rows in whole],
        "spread_chamfer_m": [_rms([[row.chamfer_m] for row in rows]) for rows in whole],
    }
    threads = [_rms([rows[0].centre_world, rows[-1].centre_world]) * 2 for rows in whole]
    return {
        "contender": contender,
        "method": first.method,
        "start": first.start,
        "category": category,
        "views": views,
        "difficulty": first.difficulty,
        "shapes": first.shapes,
        "n": len(whole),
        "n_failed": len(objects) - len(whole),
        **{name: float(np.median(values)) if values else None for name, values in spreads.items()},
        "threads_m": max(threads, default=None),
        "mode_changes": float(np.mean([changes_mode(rows) for rows in whole])) if whole else None,
    }


def changes_mode(rows: Sequence[ObjectRow]) -> bool:
    """Whether an object is found in several headings, or once with and once without a part."""
    headings = _headings(rows)
    period = 2 * np.pi / max(rows[0].truth_symmetry or 1, 1)
    apart = max(abs(_wrapped(a - b, period)) for a, b in product(headings, headings))
    recall = [row.recall or 0.0 for row in rows]
    return bool(np.degrees(apart) > MODE_DEG or max(recall) - min(recall) >= LOST)


def _headings(rows: Sequence[ObjectRow]) -> np.ndarray:
    """Radians from the true heading, each modulo symmetry and near to their mean; zero where every heading is alike."""
    symmetry = rows[0].truth_symmetry
    if symmetry == 0:
        return np.zeros(len(rows))
    R = [np.array(row.truth_T_world_object)[:3, :3].T @ np.array(row.T_world_object)[:3, :3] for row in rows]
    yaw = np.array([np.arctan2(each[0, 2] - each[2, 0], each[0, 0] + each[2, 2]) for each in R])
    period = 2 * np.pi / (symmetry or 1)
    middle = np.angle(np.exp(2j * np.pi * yaw / period).mean()) * period / (2 * np.pi)
    return np.array([middle + _wrapped(each - middle, period) for each in yaw])


def _wrapped(angle: float, period: float) -> float:
    return float((angle + period / 2) % period - period / 2)


def _rms(values: Any) -> float:
    """Root mean square distance from the mean."""
    values = np.array(values, float)
    return float(np.sqrt(((values - values.mean(axis=0)) ** 2).sum(axis=1).mean()))
