"""Tables of a map for the terminal."""

import numpy as np
from jaxtyping import Float
from rich.box import SIMPLE_HEAD
from rich.markup import escape
from rich.table import Table
from rich.text import Text

from objgraph.maps.mapped_object import MappedObject
from objgraph.maps.object_map import ObjectMap
from objgraph.show import summary
from objgraph.trust.verdict import SURE

NONE = "-"
FALLBACK = "*"
"""Marks an object of a category without a prior."""
RAW = "~"
"""Marks standard deviations that no calibration is behind."""


_COLORS = {"sure": "green", "likely": "green", "doubtful": "yellow", "poor": "red"}
_WORTH_A_WORD = 0.1
"""Probability of another heading from which on it is told."""


def map_table(object_map: ObjectMap) -> Table:
    """One row an object: its size, place and heading with standard deviations, how likely they are right, and what mapping it took.

    Place and heading are those of its box, with their calibrated covariance. Where there is none they are its own, with the
    estimator's covariance, and marked. Below it stand the reasons of those that failed, and which stand-in an object marked * was mapped with. It fits
    a terminal 80 characters wide.
    """
    counts = f"{len(object_map.mapped)} of {len(object_map.objects)} objects mapped"
    table = Table(
        title=f"Map of {escape(object_map.scene)}: {counts}",
        caption=Text("\n").join(
            [Text(line, style="dim") for line in _legend(object_map)]
            + [Text(line, style="red") for line in _remarks(object_map)]
        ),
        caption_justify="left",
        box=SIMPLE_HEAD,
        padding=0,
    )
    for label in ("id", "object", "size, m\nw x h x d"):
        table.add_column(label, justify="left" if label == "object" else "right", no_wrap=True)
    for label, least in (("box centre, m\nx ± std, y, z", 12), ("heading\n± std, °", 8), ("right", 8)):
        table.add_column(label, justify="right", min_width=least)
    for label in ("views", "time\ns"):
        table.add_column(label, justify="right", no_wrap=True)
    table.add_column("status", no_wrap=True)
    for entry in object_map.objects:
        table.add_row(
            str(entry.id),
            escape(entry.category) + FALLBACK * is_fallback(entry),
            _size(entry.size_m),
            _position(entry),
            _heading(entry, object_map.up_world),
            _right(entry),
            str(len(entry.views)),
            NONE if entry.seconds is None else f"{entry.seconds:.1f}",
            _status(entry),
        )
    return table


def _size(size_m: Float[np.ndarray, "3"] | None) -> str:
    return NONE if size_m is None else "x".join(f"{extent:.2f}" for extent in size_m)


def _position(entry: MappedObject) -> str:
    if entry.T_world_object is None:
        return NONE
    position = entry.T_world_object[:3, 3] if entry.box_centre is None else entry.box_centre
    covariance = _shown(entry)
    if covariance is None:
        return ", ".join(f"{p:.2f}" for p in position)
    sigmas = summary.position_sigma(entry.T_world_object, covariance)
    words = ", ".join(f"{p:.2f}±{s:.3f}" for p, s in zip(position, sigmas, strict=True))
    return RAW * _is_raw(entry) + words


def _heading(entry: MappedObject, up_world: Float[np.ndarray, "3"]) -> str:
    if entry.T_world_object is None:
        return NONE
    degrees = f"{np.degrees(summary.heading(entry.T_world_object, up_world)):.0f}"
    covariance = _shown(entry)
    if covariance is None:
        return degrees
    sigma = summary.heading_sigma(entry.T_world_object, covariance, up_world)
    return f"{RAW * _is_raw(entry)}{degrees}±{np.degrees(sigma):.1f}"


def _shown(entry: MappedObject) -> Float[np.ndarray, "9 9"] | None:
    """The box's covariance, the estimator's where there is none."""
    return entry.covariance if entry.box_covariance is None else entry.box_covariance


def _is_raw(entry: MappedObject) -> bool:
    return entry.box_covariance is None and entry.covariance is not None


def _right(entry: MappedObject) -> Text:
    """The verdict, a word and a number."""
    if entry.trust is None:
        return Text(NONE)
    return Text(f"{entry.trust.word}\n{entry.trust.percent} %", style=_COLORS[entry.trust.word])


def _status(entry: MappedObject) -> Text:
    return Text(entry.status, style="green" if entry.status == "mapped" else "red")


def _legend(object_map: ObjectMap) -> list[str]:
    """Whose standard deviations these are."""
    lines = []
    if any(entry.box_covariance is not None for entry in object_map.objects):
        lines.append("± of the box, calibrated, other likely headings included (box_covariance)")
        lines.append("right: probability of a pose right within 20 cm, 20° and 20 % (trust)")
    if any(map(_is_raw, object_map.objects)):
        lines.append(f"{RAW} place of the origin, ± the estimator's own: not calibrated, too small")
    return lines


def _remarks(object_map: ObjectMap) -> list[str]:
    """Why objects failed and how else they may stand, one line each, and what the mark of a fallback means: too long for
    a column."""
    reasons = [f"{e.category} {e.id} {e.status}: {e.reason}" for e in object_map.objects if e.reason]
    names = {e.prior.name for e in object_map.objects if e.prior is not None and e.prior.fallback}
    for e in object_map.objects:
        if e.trust is not None and e.trust.pose < SURE and e.trust.why:
            reasons.append(f"{e.category} {e.id} {e.trust.word}: {'; '.join(e.trust.why)}")
    reasons += [f"{e.category} {e.id} {doubt}" for e in object_map.objects if (doubt := _doubt(e))]
    return reasons + [f"{FALLBACK} no prior for this category: fallback {name}" for name in sorted(names)]


def _doubt(entry: MappedObject) -> str | None:
    """Which other headings are worth a word."""
    if entry.turns is None:
        return None
    others = {90 * quarter: p for quarter, p in enumerate(entry.turns) if quarter and p > _WORTH_A_WORD}
    words = [f"{angle}° ({100 * p:.0f} %)" for angle, p in others.items()]
    return f"may stand turned by {' or '.join(words)}" if words else None


def is_fallback(entry: MappedObject) -> bool:
    return entry.prior is not None and entry.prior.fallback
