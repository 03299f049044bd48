"""What a calibration gives on objects that it did not see."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from objgraph.trust.calibration import LEVELS, QUANTITIES
from objgraph.trust.fitted import FOLDS, Fitted, Judged, Table, fits
from objgraph.trust.regression import logistic
from objgraph.trust.verdict import SURE


def held_out(objects: Sequence[Judged], seed: int = 0) -> list[dict[str, Any]]:
    """Figures of all, of every category and of every group, each object judged by a fit to the other folds' shapes."""
    judgements = _judgements(objects, seed)
    groups = {"all": judgements} if judgements else {}
    for each in judgements:
        groups.setdefault(each.category, []).append(each)
    for each in sorted(judgements, key=lambda each: each.group):
        groups.setdefault(each.group, []).append(each)
    return [{"of": name, **_figures(some)} for name, some in groups.items()]


@dataclass(frozen=True)
class _Judgement:
    """Of an object that the fit did not see."""

    category: str
    group: str
    right: bool
    said: float
    """Probability that the pose is right."""
    held: Mapping[str, Float[np.ndarray, "l"]]
    """Whether sets hold, by level."""
    size: float
    size_marginals: float


def _judgements(objects: Sequence[Judged], seed: int) -> list[_Judgement]:
    found = []
    of = {
        name: [each for each in objects if each.category == name]
        for name in sorted({each.category for each in objects})
    }
    tables = {name: Table(some) for name, some in of.items()}
    folds = {name: table.folds(seed) for name, table in tables.items()}
    for k in range(FOLDS):
        others = {name: fold != k for name, fold in folds.items()}
        some = {name: table for name, table in tables.items() if (others[name] & table.upright).any()}
        for name, fitted in fits(some, others).items():
            table = tables[name]
            for i in np.flatnonzero(folds[name] == k).tolist():
                found.append(_judgement(of[name][i], table, fitted, i))
    return found


def _judgement(each: Judged, table: "Table", fitted: "Fitted", i: int) -> _Judgement:
    factor = {name: np.exp(table.X[i] @ fitted.usual[name]) * fitted.factors[name] for name in QUANTITIES}
    held = {name: fitted.needed[name][i] <= factor[name] for name in QUANTITIES}
    held |= {"box_marginals": table.by_marginals[i] <= 1, "box_sides": fitted.needed["box"][i] <= 1}
    return _Judgement(
        each.category, each.group, each.pose_right, float(logistic(table.X[i] @ fitted.pose)), held,
        float(np.sqrt(factor["box"][-1])) * _size(fitted.matrices[i]), _size(table.marginals[i]),
    )  # fmt: skip


def _figures(some: Sequence[_Judgement]) -> dict[str, Any]:
    right, said = np.array([each.right for each in some], float), np.array([each.said for each in some])
    sure = said >= SURE
    held = {name: np.mean([each.held[name] for each in some], axis=0) for name in some[0].held}
    return {
        "objects": len(some),
        "right": float(right.mean()),
        "brier": float(np.mean((said - right) ** 2)),
        "brier_base": float(right.mean() * (1 - right.mean())),
        "sure": int(sure.sum()),
        "sure_right": float(right[sure].mean()) if sure.any() else None,
        "set_size_95": float(np.median([each.size for each in some])),
        "set_size_95_marginals": float(np.median([each.size_marginals for each in some])),
        **{f"{name}_{level}": float(held[name][i]) for name in held for i, level in enumerate(LEVELS)},
    }


def _size(matrix: Float[np.ndarray, "9 9"]) -> float:
    """Geometric mean of the standard deviations along the axes: radians, metres and shares alike."""
    return float(np.exp(np.linalg.slogdet(matrix)[1] / 18))
