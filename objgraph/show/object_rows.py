"""The table of a map's page and of its viewer: columns, a row an object, and what to know beside the figures."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from objgraph.checked import check_fields, parse_json
from objgraph.errors import MapError
from objgraph.maps.files import EVALUATION
from objgraph.maps.mapped_object import MappedObject
from objgraph.show import summary
from objgraph.show.placement import LEAST, place_of, size_of
from objgraph.trust.verdict import SURE


class Column(NamedTuple):
    """A figure of each object."""

    key: str
    label: str
    unit: str
    digits: int


_COLUMNS = (
    Column("object", "object", "", 0), Column("status", "status", "", 0), Column("size", "w x h x d", "m", 2),
    Column("centre_sigma", "centre ±", "cm", 1), Column("heading_sigma", "heading ±", "deg", 1),
    Column("surface_sigma", "surface ±", "cm", 1), Column("other", "other headings", "%", 0),
    Column("views", "views", "", 0), Column("seconds", "time", "s", 1),
)  # fmt: skip
ERRORS = (
    Column("translation_m", "off by", "cm", 1), Column("rotation_deg", "turned by", "deg", 1),
    Column("scale_pct", "scale", "%", 1), Column("box_iou", "box IoU", "", 2), Column("chamfer_m", "Chamfer", "cm", 1),
)  # fmt: skip
"""Of `evaluation.json`."""
_EDGES = ("width", "height", "depth")
_CUT = 0.1
"""Share of the box's edge by which the mesh may be another."""
UNCALIBRATED = "standard deviations are the estimator's own: not calibrated, too small"


def columns_of(errors: Mapping[int, Any]) -> list[Column]:
    """Those of every map, and of its errors where it has any."""
    return [*_COLUMNS, *(ERRORS if errors else ())]


def object_row(entry: MappedObject, up_world: Float[np.ndarray, "3"]) -> dict[str, Any]:
    """An object's figures by column, in the columns' units; what is not known is left out."""
    place, trust = place_of(entry), entry.trust
    verdict = entry.status if trust is None else f"{trust.word}, {trust.percent} %"
    row: dict[str, Any] = {"object": entry.name, "status": verdict}
    row |= {"views": len(entry.views), "seconds": entry.seconds}
    if (size := size_of(entry)) is not None:
        row["size"] = " x ".join(f"{edge:.2f}" for edge in size)
    if place is not None and place.covariance is not None:
        sigma = summary.position_sigma(place.T_world_object, place.covariance)
        row["centre_sigma"] = 100 * float(np.linalg.norm(sigma))
        heading = summary.heading_sigma(place.T_world_object, place.covariance, up_world)
        row["heading_sigma"] = float(np.degrees(heading))
    if entry.vertex_sigma is not None:
        row["surface_sigma"] = 100 * float(np.median(entry.vertex_sigma))
    if entry.turns is not None:
        row["other"] = 100 * float(1 - entry.turns[0])
    return row


def error_row(errors: Mapping[str, Any]) -> dict[str, Any]:
    """An object's errors by column, None where there is none; metres become the column's centimetres."""
    factors = {column.key: 100.0 if column.unit == "cm" else 1.0 for column in ERRORS}
    return {key: None if errors.get(key) is None else factor * errors[key] for key, factor in factors.items()}


def remarks_of(entry: MappedObject) -> list[str]:
    """What to know of an object beside its figures."""
    remarks = [entry.reason.removeprefix(f"{entry.name}: ")] if entry.reason else []
    if entry.prior is not None and entry.prior.fallback:
        remarks.append(f"no prior for this category: stand-in {entry.prior.name}")
    place = place_of(entry)
    if place is not None and place.covariance is not None and not place.is_calibrated:
        remarks.append(UNCALIBRATED)
    if entry.trust is not None and entry.trust.pose < SURE:
        remarks += entry.trust.why
    if entry.size_m is not None and entry.box_extents is not None:
        ratio = entry.size_m / entry.box_extents
        apart = [
            f"{100 * r:.0f} % of its {edge}"
            for r, edge in zip(ratio, _EDGES, strict=True)
            if abs(r - 1) > _CUT
        ]
        remarks += [f"the mesh has {' and '.join(apart)}"] if apart else []
    if entry.turns is not None:
        others = {90 * quarter: p for quarter, p in enumerate(entry.turns) if quarter and p > LEAST}
        words = [f"{angle}° ({100 * p:.0f} %)" for angle, p in others.items()]
        remarks += [f"may stand turned by {' or '.join(words)}"] if words else []
    return remarks


def errors_beside(folder: Path) -> dict[int, dict[str, Any]]:
    """Errors by object that were written beside a map; raises MapError where they cannot be read."""
    path = folder / EVALUATION
    try:
        entries = parse_json(path.read_bytes())["objects"]
        for entry in entries:
            check_fields(entry, {"id": int, **{column.key: float | None for column in ERRORS}})
        return {entry["id"]: entry for entry in entries}
    except FileNotFoundError:
        return {}
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise MapError(f"{path}: not a readable list of errors ({error}); map the scan again") from error
