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
from objgraph.covariance.box_modes import HEADING_AXIS
from objgraph.covariance.sides import SideMisfit
from objgraph.errors import CovarianceError
from objgraph.priors.categories import category_of, plain
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
_FARTHEST = 4.0
"""Deviations from the usual: no line in the evidence is known beyond."""
_SAID = {
    "seen": "little of its surface is seen",
    "heading": "two headings fit",
    "guess": "how it stands is hard to tell from its points",
    "moved": "it ended far from the first guess",
    "off": "a part of what is seen is not on its surface",
    "through": "it stands where views saw past it",
    "size": "its size is unusual",
}


def deviations(
    given: Float[np.ndarray, "*n"] | float,
    mean: Float[np.ndarray, "*n"] | float,
    spread: Float[np.ndarray, "*n"] | float,
) -> Float[np.ndarray, "*n"]:
    """How far evidence is from the usual; no farther than objects are of which anything is known."""
    return np.clip((np.asarray(given) - mean) / spread, -_FARTHEST, _FARTHEST)


@dataclass(frozen=True)
class Line:
    """A linear function of the evidence in standard deviations."""

    intercept: float
    weights: Mapping[str, float]

    def __call__(self, z: Mapping[str, float]) -> float:
        return self.intercept + sum(self.weights[name] * value for name, value in z.items())


@dataclass(frozen=True)
class Widening:
    """Factors on the variances of a quantity: e to the line's value, times that of the level."""

    line: Line
    factors: Mapping[str, float]
    """By level in per cent."""


@dataclass(frozen=True)
class CategoryCalibration:
    """What was learnt of the objects of a category."""

    prior: str
    """Digest of the weights of the prior that they were estimated with."""
    objects: int
    """How many stand behind it."""
    mean: Mapping[str, float]
    """Of each kind of evidence."""
    spread: Mapping[str, float]
    pose: Line
    """Log-odds of a right pose."""
    shape: Line
    """Log-odds of a Chamfer distance below 3 cm."""
    sides: SideMisfit
    widening: Mapping[str, Widening]
    """Of boxes and headings beyond what the sides' errors add."""

    def trust(self, evidence: Evidence, digest: str) -> Trust:
        given, z = evidence.to_json(), self._z(evidence)
        against = {name: self.pose.weights[name] * z[name] for name in NAMES}
        worst = sorted((name for name in NAMES if against[name] < -_LEAST_LOG_ODDS), key=against.__getitem__)
        # the map has the box at the last level, and the surface as the graph gives it
        there = {"surface": 1.0}
        box = self.factor("box", evidence)
        widening = {
            name: {level: self.factor(name, evidence, level) / there.get(name, box) for level in LEVELS}
            for name in QUANTITIES
        }
        pose, shape = _probability(self.pose(z)), _probability(self.shape(z))
        return Trust(pose, shape, tuple(_SAID[name] for name in worst), widening, given, digest)

    def box(self, evidence: Evidence, box: BoxPose, seen_sides: Float[np.ndarray, "3 2"]) -> BoxPose:
        """A box, given with its marginals, with the covariance at which 95 % sets hold as many (see `evidence_of`).

        No heading is farther off than half a turn, so the heading's deviation is no more.
        """
        matrix = self.sides.widened(box.covariance.matrix, box.extents, seen_sides)
        matrix = self.factor("box", evidence) * matrix
        least = np.ones(len(matrix))
        least[[*HEADING_AXIS]] = min(1.0, math.pi / math.sqrt(max(matrix[HEADING_AXIS * 2], 1e-12)))
        matrix = least[:, None] * matrix * least
        return replace(box, covariance=replace(box.covariance, matrix=matrix, source="calibrated"))

    def factor(self, quantity: str, evidence: Evidence, level: str = LEVELS[-1]) -> float:
        """On the variances of a quantity, those of boxes and headings with the sides' errors: so that sets of this level hold as
        many as they say."""
        widening = self.widening[quantity]
        return math.exp(max(min(widening.line(self._z(evidence)), 50.0), -50.0)) * widening.factors[level]

    def _z(self, evidence: Evidence) -> dict[str, float]:
        given = evidence.to_json()
        return {name: float(deviations(given[name], self.mean[name], self.spread[name])) for name in NAMES}


@dataclass(frozen=True)
class Calibration:
    """See `objgraph.trust.fit.fit`. It speaks of the graph's estimates with the priors that it names."""

    categories: Mapping[str, CategoryCalibration]
    made: Mapping[str, Any]
    """From which runs, seeds and program, and what it gives on objects that were held out."""

    def of(self, category: str, prior: str) -> CategoryCalibration | None:
        """What it knows of a category's objects, estimated with a prior of this digest; None where that is nothing.

        A prior serves its category however either is spelt, and the labels that mean it: so does what is known of these.
        """
        names = [category, *(name for name in self.categories if _meant(name) == _meant(category))]
        known = (self.categories[name] for name in names if name in self.categories)
        return next((each for each in known if each.prior == prior), None)

    def beside(self, earlier: "Calibration") -> "Calibration":
        """This one, and of the earlier one the categories that this one lacks; `made["kept"]` says how each of these was made."""
        kept = {name: each for name, each in earlier.categories.items() if name not in self.categories}
        own, fits = set(kept), []
        for fit in earlier.made.get("kept", []):
            own -= set(fit["categories"])
            fits.append((kept.keys() & set(fit["categories"]), fit["made"]))
        fits.insert(0, (own, {name: said for name, said in earlier.made.items() if name != "kept"}))
        of_kept = [{"categories": sorted(names), "made": made} for names, made in fits if names]
        return Calibration({**kept, **self.categories}, {**self.made, "kept": of_kept})

    @property
    def digest(self) -> str:
        return hashlib.sha256(self.to_bytes()).hexdigest()[:12]

    def to_bytes(self) -> bytes:
        document = {"version": VERSION, **asdict(self)}
        return json.dumps(document, indent=1, sort_keys=True).encode() + b"\n"

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
    check_fields(document, {"version": int, "categories": dict[str, dict], "made": dict})
    if document.pop("version") != VERSION:
        raise ValueError(f"not of version {VERSION}")
    categories = {name: _category(each) for name, each in document.pop("categories").items()}
    return Calibration(categories, **document)


def _category(document: Any) -> CategoryCalibration:
    numbers = dict[str, float]
    check_fields(
        document,
        {"prior": str, "objects": int, "mean": numbers, "spread": numbers, "pose": dict, "shape": dict, "sides": dict,
         "widening": dict[str, dict]},
    )  # fmt: skip
    _named("mean", document["mean"], NAMES)
    _named("spread", document["spread"], NAMES)
    if min(document["spread"].values()) <= 0:
        raise ValueError("a spread is not positive")
    _named("widening", document["widening"], QUANTITIES)
    widening = {}
    for name, each in document["widening"].items():
        check_fields(each, {"line": dict, "factors": numbers})
        _named("factors", each["factors"], LEVELS)
        if min(each["factors"].values()) <= 0:
            raise ValueError(f"a factor of {name} is not positive")
        widening[name] = Widening(_line(each["line"]), each["factors"])
    parts = {
        "pose": _line(document["pose"]),
        "shape": _line(document["shape"]),
        "sides": typed(SideMisfit, document["sides"]),
        "widening": widening,
    }
    return CategoryCalibration(**{**document, **parts})


def _line(document: Any) -> Line:
    check_fields(document, {"intercept": float, "weights": dict[str, float]})
    _named("weights", document["weights"], NAMES)
    return Line(**document)


def _named(what: str, given: Mapping[str, Any], names: tuple[str, ...]) -> None:
    if set(given) != set(names):
        raise ValueError(f"{what} are of {', '.join(given)}, not of {', '.join(names)}")


def _meant(category: str) -> str:
    return plain(category_of(category))


def _probability(log_odds: float) -> float:
    return min(max(1 / (1 + math.exp(-max(min(log_odds, 50.0), -50.0))), _ALMOST), 1 - _ALMOST)
