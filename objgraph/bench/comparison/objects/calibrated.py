"""What a calibration makes of rows: sets that it widened, and verdicts."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from objgraph.bench.comparison.objects.judged import METHOD, judged
from objgraph.bench.comparison.objects.rows import OWN, ObjectRow
from objgraph.covariance.box_modes import EVERY_AXIS, HEADING_AXIS, factor_needed
from objgraph.covariance.quantile import squared_limit
from objgraph.trust.calibration import LEVELS, Calibration, CategoryCalibration
from objgraph.trust.fitted import Judged

MEASURED = (
    "with a calibration, of n_judged estimates of the graph from its own start whose objects it knows, failures not among them: coverage*_sides: share of boxes in the set of all modes with the sides' errors; "
    "coverage*_calibrated, heading95_calibrated: the same widened; coverage95_surface: share of objects of whose surface 95 % lie within; "
    "set_size: geometric mean of the standard deviations of the 95 % box set, median; wrong_modes_outside: share of objects whose heading is "
    "of another mode and whose box is outside of the 95 % set; verdict_brier: of the probability that the pose is right, verdict_brier_base: "
    "of the rate; sure: share of objects called right with 90 %, sure_right: of them right"
)


def of_rows(rows: Sequence[ObjectRow], known: Calibration) -> dict[str, Float[np.ndarray, "n"]]:
    """Figures of each row; NaN where there is no estimate, or the calibration does not know such an object."""
    found: list[dict[str, float]] = []
    for row in rows:
        # from another start there was no choice of headings, which is evidence
        usable = (row.method, row.start) == (METHOD, OWN) and None not in (
            row.evidence, row.box_modes, row.surface_error,
        )  # fmt: skip
        of = known.of(row.category, row.prior)
        found.append(_of(row, judged([row])[0], of) if usable and of is not None else {})
    names = sorted({name for each in found for name in each})
    return {name: np.array([each.get(name, np.nan) for each in found]) for name in names}


def _of(row: ObjectRow, each: Judged, known: CategoryCalibration) -> dict[str, float]:
    trust = known.trust(each.evidence, "")
    matrix = known.sides.widened(each.marginals, each.extents, each.seen_sides)

    def holds(level: str, axes: tuple[int, ...], factor: float) -> float:
        return float(
            factor_needed(each.modes, matrix, squared_limit(float(level) / 100, len(axes)), axes) <= factor
        )

    def factor(quantity: str, level: str) -> float:
        return known.factor(quantity, each.evidence, level)

    figures = {f"coverage{level}_sides": holds(level, EVERY_AXIS, 1.0) for level in LEVELS}
    figures |= {
        f"coverage{level}_calibrated": holds(level, EVERY_AXIS, factor("box", level)) for level in LEVELS
    }
    wrong = row.heading_error_deg is not None and row.heading_error_deg > 45.0
    size = np.exp(np.linalg.slogdet(matrix)[1] / 18) * np.sqrt(factor("box", "95"))
    sure = trust.word == "sure"
    return figures | {
        "heading95_calibrated": holds("95", HEADING_AXIS, factor("heading", "95")),
        "coverage95_surface": float(each.surface["95"] <= factor("surface", "95")),
        "set_size": float(size),
        "wrong_modes_outside": float(wrong and not figures["coverage95_calibrated"]),
        "verdict_brier": (trust.pose - each.pose_right) ** 2,
        "pose_right": float(each.pose_right),
        "sure": float(sure),
        "sure_right": float(each.pose_right) if sure else np.nan,
    }
