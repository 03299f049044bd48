"""Calibrations and objects that are made up."""

from dataclasses import replace

import numpy as np

from objgraph.covariance.sides import SideMisfit
from objgraph.trust.calibration import LEVELS, QUANTITIES, Calibration, CategoryCalibration, Line, Widening
from objgraph.trust.evidence import NAMES, Evidence
from objgraph.trust.fitted import Judged

EVIDENCE = Evidence(seen=0.5, heading=0.9, guess=0.9, moved=0.05, off=0.1, through=0.01, size=0.5)
SIDES = SideMisfit(3.0, 0.012, 0.15)


def calibration(prior: str = "weights") -> Calibration:
    """Of chairs: more seen is better, and everything is widened by something."""
    zero = dict.fromkeys(NAMES, 0.0)
    line = Line(0.6, {**zero, "seen": 1.5, "moved": -1.0})
    wider = Line(0.2, {**zero, "seen": -0.5})
    mean = {**zero, "seen": 0.5, "heading": 0.9}
    factors: dict[str, float] = dict(zip(LEVELS, (1.0, 2.0, 3.0), strict=True))
    chair = CategoryCalibration(
        prior, 50, mean, dict.fromkeys(NAMES, 0.2), line, replace(line, intercept=-0.9), SIDES,
        {name: Widening(wider, factors) for name in QUANTITIES},
    )  # fmt: skip
    return Calibration({"chair": chair}, {"program": "none"})


def objects(count: int, seed: int = 0, tail: float = 0.0, misfit: SideMisfit = SIDES) -> list[Judged]:
    """Chairs and tables with boxes that err as the misfit of sides says, and more, by e to the power of `tail`, the less is seen; poses are
    right with a probability that grows with what is seen."""
    rng = np.random.default_rng(seed)
    made = []
    for i in range(count):
        seen = rng.uniform(0.1, 0.9)
        evidence = replace(EVIDENCE, seen=seen, moved=rng.uniform(0, 0.1))
        root = rng.normal(size=(9, 9)) * 0.005
        marginals = root @ root.T + 1e-6 * np.eye(9)
        extents, sides = rng.uniform(0.4, 1.6, 3), rng.uniform(size=(3, 2))
        matrix = misfit.widened(marginals, extents, sides)
        wider = np.exp(tail * (1 - seen) + 0.3 * rng.normal())
        error = wider * np.linalg.cholesky(matrix) @ rng.normal(size=9)
        right = rng.uniform() < 1 / (1 + np.exp(-12 * (seen - 0.4)))
        made.append(
            Judged(
                ("chair", "table")[i % 2], f"shape {i // 4}", "made up", evidence, bool(right), seen > 0.6,
                [(0.9, error), (0.1, error + 1.0)], marginals, extents, sides,
                {level: float(wider**2) for level in LEVELS},
            )
        )  # fmt: skip
    return made
