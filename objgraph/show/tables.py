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

NONE = "-"
FALLBACK = "*"
"""Marks an object of a category without a prior."""


_WORTH_A_WORD = 0.1
"""Probability of another heading from which on it is told."""


def map_table(object_map: ObjectMap) -> Table:
    """One row an object: its size, place and heading with standard deviations, and what mapping it took.

    Below it stand the reasons of those that failed, and which stand-in an object marked * was mapped with. It fits
    a terminal 80 characters wide.
    """
    counts = f"{len(object_map.mapped)} of {len(object_map.objects)} objects mapped"
    table = Table(
        title=f"Map of {escape(object_map.scene)}: {counts}",
        caption=Text("\n".join(_remarks(object_map)), style="red"),
        caption_justify="left",
        box=SIMPLE_HEAD,
        padding=0,
    )
    for label in ("id", "object", "size, m\nw x h x d"):
        table.add_column(label, justify="left" if label == "object" else "right", no_wrap=True)
    for label, least in (("position, m\nx ± std, y, z", 12), ("heading\n± std, °", 8), ("cost", 8)):
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
            _cost(entry),
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
    position = entry.T_world_object[:3, 3]
    if entry.covariance is None:
        return ", ".join(f"{p:.2f}" for p in position)
    sigmas = summary.position_sigma(entry.T_world_object, entry.covariance)
    return ", ".join(f"{p:.2f}±{s:.3f}" for p, s in zip(position, sigmas, strict=True))


def _heading(entry: MappedObject, up_world: Float[np.ndarray, "3"]) -> str:
    if entry.T_world_object is None:
        return NONE
    degrees = f"{np.degrees(summary.heading(entry.T_world_object, up_world)):.0f}"
    if entry.covariance is None:
        return degrees
    sigma = summary.heading_sigma(entry.T_world_object, entry.covariance, up_world)
    return f"{degrees}±{np.degrees(sigma):.1f}"


def _cost(entry: MappedObject) -> str:
    if entry.cost_initial is None and entry.cost_final is None:
        return NONE
    ends = (entry.cost_initial, entry.cost_final)
    return " -> ".join(NONE if cost is None else f"{cost:.4g}" for cost in ends)


def _status(entry: MappedObject) -> Text:
    return Text(entry.status, style="green" if entry.status == "mapped" else "red")


def _remarks(object_map: ObjectMap) -> list[str]:
    """Why objects failed and how else they may stand, one line each, and what the mark of a fallback means: too long for
    a column."""
    reasons = [f"{e.category} {e.id} {e.status}: {e.reason}" for e in object_map.objects if e.reason]
    names = {e.prior.name for e in object_map.objects if e.prior is not None and e.prior.fallback}
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
