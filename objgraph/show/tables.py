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
from objgraph.show.object_rows import UNCALIBRATED, remarks_of
from objgraph.show.placement import place_of, size_of

NONE = "-"
FALLBACK = "*"
"""Marks an object of a category without a prior."""
RAW = "~"
"""Marks standard deviations that no calibration is behind."""


_COLORS = {"sure": "green", "likely": "green", "doubtful": "yellow", "poor": "red"}


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
        show_edge=False,
        padding=0,
    )
    table.add_column("id", justify="right", no_wrap=True)
    table.add_column("object", overflow="fold", max_width=11)
    table.add_column("size, m\nw x h x d", justify="right", no_wrap=True)
    for label, least in (("box centre, m\nx ± std, y, z", 12), ("heading\n± std, °", 8), ("right", 8)):
        table.add_column(label, justify="right", min_width=least, overflow="fold")
    for label in ("views", "time\ns"):
        table.add_column(label, justify="right", no_wrap=True)
    table.add_column("status", no_wrap=True)
    for entry in object_map.objects:
        table.add_row(
            str(entry.id),
            escape(entry.category) + FALLBACK * entry.is_fallback,
            _size(size_of(entry)),
            _position(entry),
            _heading(entry, object_map.up_world),
            _right(entry),
            str(len(entry.views)),
            NONE if entry.seconds is None else f"{entry.seconds:.1f}",
            _status(entry),
        )
    return table


def _size(size: Float[np.ndarray, "3"] | None) -> str:
    return NONE if size is None else "x".join(f"{extent:.2f}" for extent in size)


def _position(entry: MappedObject) -> str:
    place = place_of(entry)
    if place is None:
        return NONE
    if place.covariance is None:
        return ", ".join(f"{p:.2f}" for p in place.centre)
    sigmas = summary.position_sigma(place.T_world_object, place.covariance)
    words = ", ".join(f"{p:.2f}±{s:.3f}" for p, s in zip(place.centre, sigmas, strict=True))
    return RAW * (not place.is_calibrated) + words


def _heading(entry: MappedObject, up_world: Float[np.ndarray, "3"]) -> str:
    place = place_of(entry)
    if place is None:
        return NONE
    degrees = f"{np.degrees(summary.heading(place.T_world_object, up_world)):.0f}"
    if place.covariance is None:
        return degrees
    sigma = summary.heading_sigma(place.T_world_object, place.covariance, up_world)
    return f"{RAW * (not place.is_calibrated)}{degrees}±{np.degrees(sigma):.1f}"


def _right(entry: MappedObject) -> Text:
    """The verdict, a word and a number."""
    if entry.trust is None:
        return Text(NONE)
    return Text(f"{entry.trust.word}\n{entry.trust.percent} %", style=_COLORS[entry.trust.word])


def _status(entry: MappedObject) -> Text:
    return Text(entry.status, style="green" if entry.status == "mapped" else "red")


def _legend(object_map: ObjectMap) -> list[str]:
    """Whose standard deviations these are."""
    places = [place for entry in object_map.objects if (place := place_of(entry)) is not None]
    lines = []
    if any(place.is_calibrated for place in places):
        lines.append("± of the box, calibrated, other likely headings included (box_covariance)")
        lines.append("right: probability of a pose right within 20 cm, 20° and 20 % (trust)")
    if any(place.covariance is not None and not place.is_calibrated for place in places):
        lines.append(f"{RAW} place of the origin, ± the estimator's own: not calibrated, too small")
    if any(entry.is_fallback for entry in object_map.objects):
        lines.append(f"{FALLBACK} no prior for this category: another stood in")
    return lines


def _remarks(object_map: ObjectMap) -> list[str]:
    """What to know beside the figures, a line an object: too long for a column."""
    lines = []
    for entry in object_map.objects:
        remarks = [remark for remark in remarks_of(entry) if remark != UNCALIBRATED]  # its figures are marked
        lines += [f"{entry.name}: {'; '.join(remarks)}"] if remarks else []
    return lines
