"""A picture of how often first guesses are as right as they say: `python -m objgraph.bench.pictures.headings`."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro
from jaxtyping import Float
from matplotlib.figure import Figure

from objgraph.checked import parse_json
from objgraph.errors import EvaluationError
from objgraph.show import figure

_LEAST = 0.01
"""Headings below that are next to impossible, and of most objects the most."""


@dataclass(frozen=True)
class HeadingsConfig:
    """A point for headings of about one probability, at how many of them are right: of a shape that looks the same from several
    each is so in equal parts."""

    out: Path
    """The PNG to write."""
    evaluations: tuple[Path, ...]
    """What `objgraph evaluate-prior --json` wrote, a category each."""
    views: int = 3
    """Of each object."""
    bins: int = 6
    """Of equally many headings above one in a hundred."""


@dataclass(frozen=True)
class Reliability:
    """Of headings in the order of their probability, in bins of equally many."""

    probability: Float[np.ndarray, "b"]
    right: Float[np.ndarray, "b"]


def reliability(
    probability: Float[np.ndarray, "n"], wanted: Float[np.ndarray, "n"], bins: int
) -> Reliability:
    """Mean probability of each bin and of what it should be, from the least likely headings on."""
    order = np.argsort(probability, kind="stable")
    parts = [part for part in np.array_split(order[probability[order] > _LEAST], bins) if len(part)]
    return Reliability(
        np.array([probability[part].mean() for part in parts]),
        np.array([wanted[part].mean() for part in parts]),
    )


def headings_picture(config: HeadingsConfig) -> None:
    """Draw the curves of all categories.

    Raises:
        EvaluationError: a file is no evaluation of a prior with a first guess.
    """
    curves = [_read(path, config) for path in config.evaluations]
    _draw(curves, config)


def _read(path: Path, config: HeadingsConfig) -> tuple[str, int, Reliability]:
    try:
        document = parse_json(path.read_bytes())
        found = document["first_guess"][str(config.views)]
        said, wanted = (np.array(found[key], float).ravel() for key in ("probability", "wanted"))
        return str(document["category"]), int(found["objects"]), reliability(said, wanted, config.bins)
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise EvaluationError(
            f"{path} has no first guess from {config.views} views: write it by `objgraph evaluate-prior --json`"
        ) from error


def _draw(curves: Sequence[tuple[str, int, Reliability]], config: HeadingsConfig) -> None:
    sheet = Figure(figsize=(5.5, 4.5), dpi=110, facecolor="white")
    axes = sheet.subplots()
    axes.plot([0, 1], [0, 1], color="0.75", linewidth=1)
    for category, count, curve in curves:
        axes.plot(curve.probability, curve.right, "o-", markersize=4, label=f"{category} ({count})")
    axes.set_xlim(-0.02, 1.02)
    axes.set_ylim(-0.02, 1.02)
    axes.set_xlabel("probability of a heading")
    axes.set_ylabel("share that is right")
    axes.legend(frameon=False, fontsize=8)
    figure.finish(sheet, None, None, config.out)


if __name__ == "__main__":
    headings_picture(tyro.cli(HeadingsConfig))
