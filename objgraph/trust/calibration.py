"""A calibration: what was learnt on objects with ground truth of how far estimates are to be trusted. A JSON file."""

import hashlib
import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from objgraph.atomic import write_file
from objgraph.checked import check_fields, parse_json, typed
from objgraph.covariance.box import BoxPose
from objgraph.covariance.sides import SideMisfit
from objgraph.errors import CovarianceError
from objgraph.trust.evidence import NAMES, Evidence
from objgraph.trust.verdict import Trust

VERSION = 1
QUANTITIES = ("box", "heading", "surface")
LEVELS = ("50", "90", "95")
"""Per cent."""
_LEAST_LOG_ODDS = 0.7
"""Evidence that halves the odds is worth a word."""
_ALMOST = 1e-3
"""No verdict is surer than the objects behind it can show."""
_SAID = {
    "seen": "little of its surface is seen",
    "heading": "two headings fit",
    "guess": "how it stands is hard to tell from its points",
    "moved": "it ended far from the first guess",
    "off": "a part of what is seen is not on its surface",
    "through": "it stands where views saw past it",
    "size": "its size is unusual",
}


@dataclass(frozen=True)
class Line:
    """A linear function of the evidence in standard deviations, with an offset by category."""

    intercept: float
    offsets: Mapping[str, float]
    weights: Mapping[str, float]

    def __call__(self, category: str, z: Mapping[str, float]) -> float:
        terms = (self.weights[name] * value for name, value in z.items())
        return self.intercept + self.offsets.get(category, 0.0) + sum(terms)


@dataclass(frozen=True)
class Widening:
    """Factors on the variances of a quantity: e to the line's value, times that of the level."""

    line: Line
    factors: Mapping[str, float]
    """By level in per cent."""


@dataclass(frozen=True)
class Calibration:
    """See `objgraph.trust.fit.fit`. It speaks of the graph's estimates with the priors that it names."""

    mean: Mapping[str, float]
    """Of each kind of evidence."""
    spread: Mapping[str, float]
    pose: Line
    """Log-odds of a right pose."""
    shape: Line
    """Log-odds of a Chamfer distance below 3 cm."""
    sides: Mapping[str, SideMisfit]
    """By category."""
    widening: Mapping[str, Widening]
    """Of boxes beyond what the sides' errors add."""
    priors: Mapping[str, str]
    """Digest of the weights by category."""
    objects: Mapping[str, int]
    """How many stand behind it, by category."""
    made: Mapping[str, Any]
    """From which runs, seeds and program, and what it gives on objects that were held out."""

    def trust(self, category: str, prior: str, evidence: Evidence) -> Trust | None:
        """What it says of an object; None where it knows nothing of such a prior (its digest)."""
        if self.priors.get(category) != prior:
            return None
        given, z = evidence.to_json(), self._z(evidence)
        against = {name: self.pose.weights[name] * z[name] for name in NAMES}
        worst = sorted((name for name in NAMES if against[name] < -_LEAST_LOG_ODDS), key=against.__getitem__)
        return Trust(
            _probability(self.pose(category, z)),
            _probability(self.shape(category, z)),
            tuple(_SAID[name] for name in worst),
            {
                name: {
                    level: self.factor(name, category, evidence, level)
                    / self._in_the_map(name, category, evidence)
                    for level in LEVELS
                }
                for name in QUANTITIES
            },
            given,
            self.digest,
        )

    def box(
        self, category: str, evidence: Evidence, box: BoxPose, seen_sides: Float[np.ndarray, "3 2"]
    ) -> BoxPose:
        """A box, given with its marginals, with the covariance at which 95 % sets hold as many; see `evidence_of`."""
        matrix = widened(self.sides[category], box.covariance.matrix, box.extents, seen_sides)
        factor = self.factor("box", category, evidence)
        return replace(box, covariance=replace(box.covariance, matrix=factor * matrix))

    def factor(self, quantity: str, category: str, evidence: Evidence, level: str = LEVELS[-1]) -> float:
        """On the variances of a quantity, that of boxes and headings with the sides' errors: so that sets of this level hold as
        many as they say."""
        widening = self.widening[quantity]
        usual = math.exp(max(min(widening.line(category, self._z(evidence)), 50.0), -50.0))
        return usual * widening.factors[level]

    def _in_the_map(self, quantity: str, category: str, evidence: Evidence) -> float:
        """The factor that the map's covariance of a quantity has already."""
        return 1.0 if quantity == "surface" else self.factor("box", category, evidence)

    def _z(self, evidence: Evidence) -> dict[str, float]:
        given = evidence.to_json()
        return {name: (given[name] - self.mean[name]) / self.spread[name] for name in NAMES}

    @property
    def digest(self) -> str:
        return hashlib.sha256(self.to_bytes()).hexdigest()[:12]

    def to_bytes(self) -> bytes:
        return json.dumps({"version": VERSION, **asdict(self)}, indent=1, sort_keys=True).encode() + b"\n"

    def save(self, path: Path) -> None:
        """Raises CovarianceError where the file cannot be written; an earlier one is still there then."""
        write_file(path, self.to_bytes(), CovarianceError)


def load_calibration(path: Path) -> Calibration:
    """The calibration in a file that `objgraph calibrate` wrote; raises CovarianceError where it is none."""
    try:
        return _parsed(path.read_bytes())
    except (OSError, ValueError, TypeError, KeyError) as error:
        raise CovarianceError(
            f"{path}: no calibration of this version ({error}); make one with `objgraph calibrate`"
        ) from error


@cache
def shipped_calibration() -> Calibration:
    """That of the shipped priors, from the benchmark's scans."""
    return _parsed(files("objgraph.trust").joinpath("shipped.json").read_bytes())


def _parsed(data: bytes) -> Calibration:
    document = parse_json(data)
    numbers = dict[str, float]
    check_fields(
        document,
        {"version": int, "mean": numbers, "spread": numbers, "pose": dict, "shape": dict, "sides": dict, "widening": dict,
         "priors": dict[str, str], "objects": dict[str, int], "made": dict},
    )  # fmt: skip
    if document.pop("version") != VERSION:
        raise ValueError(f"not of version {VERSION}")
    _named("mean", document["mean"], NAMES)
    _named("spread", document["spread"], NAMES)
    if min(document["spread"].values()) <= 0:
        raise ValueError("a spread is not positive")
    _named("widening", document["widening"], QUANTITIES)
    _named("sides", document["sides"], tuple(document["priors"]))
    sides = {name: typed(SideMisfit, each) for name, each in document["sides"].items()}
    widening = {}
    for name, each in document["widening"].items():
        check_fields(each, {"line": dict, "factors": numbers})
        _named("factors", each["factors"], LEVELS)
        if min(each["factors"].values()) <= 0:
            raise ValueError(f"a factor of {name} is not positive")
        widening[name] = Widening(_line(each["line"]), each["factors"])
    lines = {name: _line(document[name]) for name in ("pose", "shape")}
    return Calibration(**{**document, **lines, "sides": sides, "widening": widening})


def _line(document: Any) -> Line:
    check_fields(document, {"intercept": float, "offsets": dict[str, float], "weights": dict[str, float]})
    _named("weights", document["weights"], NAMES)
    return Line(**document)


def _named(what: str, given: Mapping[str, Any], names: tuple[str, ...]) -> None:
    if set(given) != set(names):
        raise ValueError(f"{what} are of {', '.join(given)}, not of {', '.join(names)}")


def _probability(log_odds: float) -> float:
    return min(max(1 / (1 + math.exp(-max(min(log_odds, 50.0), -50.0))), _ALMOST), 1 - _ALMOST)


def widened(
    sides: SideMisfit,
    marginals: Float[np.ndarray, "... 9 9"],
    extents: Float[np.ndarray, "... 3"],
    seen_sides: Float[np.ndarray, "... 3 2"],
) -> Float[np.ndarray, "... 9 9"]:
    """A box's covariance with the sides' errors."""
    return sides.marginals * np.asarray(marginals) + sides.matrix(extents, seen_sides)
