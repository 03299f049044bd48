"""What the page shows of a map, as JSON: the table's columns, each object's facts, meshes, ellipsoids and modes."""

import base64
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from jaxtyping import Float
from matplotlib.colors import to_hex
from scipy.stats import chi2

from factors.state import ObjectState
from objgraph.errors import MapError
from objgraph.maps.colors import sigma_colormap, sigma_limit
from objgraph.maps.files import EVALUATION, read_document
from objgraph.maps.mapped_object import MappedObject
from objgraph.maps.object_map import ObjectMap
from objgraph.show import summary
from objgraph.show.report.views import ObjectPicture

LEVEL = 0.95
"""Of the ellipsoids."""
_POINTS = 80_000
_LEAST = 0.02
"""Probability of another heading below which it is not drawn."""
_COLUMNS = (
    ("object", "object", "", 0), ("status", "status", "", 0), ("size", "w x h x d", "m", 2),
    ("centre_sigma", "centre ±", "cm", 1), ("heading_sigma", "heading ±", "deg", 1),
    ("surface_sigma", "surface ±", "cm", 1), ("other", "other headings", "%", 0), ("views", "views", "", 0),
    ("seconds", "time", "s", 1),
)  # fmt: skip
"""Key, in words, unit, digits."""
_ERRORS = (
    ("translation_m", "off by", "cm", 1, 100.0), ("rotation_deg", "turned by", "deg", 1, 1.0),
    ("scale_pct", "scale", "%", 1, 1.0), ("box_iou", "box IoU", "", 2, 1.0), ("chamfer_m", "Chamfer", "cm", 1, 100.0),
)  # fmt: skip
"""Of `evaluation.json`: the same, and a factor."""


def map_contents(
    folder: Path,
    points_world: Float[np.ndarray, "n 3"] | None,
    colors: Float[np.ndarray, "n 3"] | None,
    pictures: Mapping[int, Sequence[ObjectPicture]],
) -> dict[str, Any]:
    """All of a saved map that its page shows; no number that JSON does not have.

    Raises:
        MapError: there is no map, or it or the errors beside it are damaged.
    """
    object_map = ObjectMap.load(folder)
    files = {entry["id"]: entry.get("mesh") for entry in read_document(folder)["objects"]}
    errors = _errors(folder / EVALUATION)
    limit = sigma_limit(entry.vertex_sigma for entry in object_map.objects)
    columns = [*_COLUMNS, *(each[:4] for each in _ERRORS if errors)]
    objects = []
    for entry in object_map.objects:
        mesh = files[entry.id]
        objects.append(
            {
                "id": entry.id,
                "name": f"{entry.category} {entry.id}",
                "mapped": entry.status == "mapped",
                "row": _row(entry, object_map.up_world) | _error_row(errors.get(entry.id, {})),
                "remarks": _remarks(entry),
                "mesh": _base64((folder / mesh).read_bytes()) if mesh else None,
                "ellipsoid": _ellipsoid(entry),
                "box": _box(entry),
                "modes": _modes(entry),
                "views": [
                    {"frame": each.frame, "jpeg": _jpeg(each.rgb)} for each in pictures.get(entry.id, ())
                ],
            }
        )
    return {
        "title": object_map.scene,
        "mapped": len(object_map.mapped),
        "up": object_map.up_world.tolist(),
        "level": LEVEL,
        "columns": [dict(zip(("key", "label", "unit", "digits"), each, strict=True)) for each in columns],
        "errors": _ERRORS[0][1] if errors else None,
        "objects": objects,
        "points": None if points_world is None else _points(points_world, colors),
        "sigma": None if limit is None else {"limit_cm": 100 * limit, "colors": _scale()},
    }


def _row(entry: MappedObject, up_world: Float[np.ndarray, "3"]) -> dict[str, Any]:
    covariance = entry.covariance if entry.box_covariance is None else entry.box_covariance
    row: dict[str, Any] = {"object": f"{entry.category} {entry.id}", "status": entry.status}
    row |= {"views": len(entry.views), "seconds": entry.seconds}
    if entry.size_m is not None:
        row["size"] = " x ".join(f"{edge:.2f}" for edge in entry.size_m)
    if entry.T_world_object is not None and covariance is not None:
        sigma = summary.position_sigma(entry.T_world_object, covariance)
        row["centre_sigma"] = 100 * float(np.linalg.norm(sigma))
        row["heading_sigma"] = float(
            np.degrees(summary.heading_sigma(entry.T_world_object, covariance, up_world))
        )
    if entry.vertex_sigma is not None:
        row["surface_sigma"] = 100 * float(np.median(entry.vertex_sigma))
    if entry.turns is not None:
        row["other"] = 100 * float(1 - entry.turns[0])
    return row


def _error_row(errors: Mapping[str, Any]) -> dict[str, Any]:
    return {key: None if errors.get(key) is None else factor * errors[key] for key, *_, factor in _ERRORS}


def _remarks(entry: MappedObject) -> list[str]:
    """What to know of an object beside its figures."""
    remarks = [entry.reason] if entry.reason else []
    if entry.prior is not None and entry.prior.fallback:
        remarks.append(f"no prior for this category: stand-in {entry.prior.name}")
    if entry.box_covariance is None and entry.covariance is not None:
        remarks.append("standard deviations are the estimator's own: not calibrated, too small")
    if entry.turns is not None:
        others = {90 * quarter: p for quarter, p in enumerate(entry.turns) if quarter and p > _LEAST}
        remarks += [f"may stand turned by {angle}°: {100 * p:.0f} %" for angle, p in others.items()]
    return remarks


def _ellipsoid(entry: MappedObject) -> list[float] | None:
    """What makes the unit sphere the ellipsoid of the box's centre: column-major, as WebGL has matrices."""
    if entry.T_world_object is None:
        return None
    covariance, centre = entry.covariance, entry.T_world_object[:3, 3]
    if entry.box_covariance is not None and entry.box_centre is not None:
        covariance, centre = entry.box_covariance, entry.box_centre
    if covariance is None:
        return None
    variances, axes = np.linalg.eigh(summary.position_covariance(entry.T_world_object, covariance))
    matrix = np.eye(4)
    matrix[:3, :3] = axes * np.sqrt(variances.clip(min=1e-12) * chi2.ppf(LEVEL, 3))
    matrix[:3, 3] = centre
    return matrix.T.ravel().tolist()


def _box(entry: MappedObject) -> list[float] | None:
    """What makes the unit cube about the origin the object's box."""
    if entry.T_world_object is None or entry.vertices is None:
        return None
    R = entry.T_world_object[:3, :3]
    if entry.box_centre is not None and entry.box_extents is not None:
        centre, extents = entry.box_centre, entry.box_extents
    else:
        p_object = entry.vertices @ R
        low, high = p_object.min(axis=0), p_object.max(axis=0)
        centre, extents = R @ (low + high) / 2, high - low
    matrix = np.eye(4)
    matrix[:3, :3] = R * extents
    matrix[:3, 3] = centre
    return matrix.T.ravel().tolist()


def _modes(entry: MappedObject) -> list[dict[str, Any]]:
    """Other headings, each with what moves the mesh there; the shape is that of the likeliest."""
    modes = entry.other_headings
    if modes is None or entry.turned is None:
        return []
    found = []
    here = _placed(entry.state)
    for p, state in list(zip(modes.probability, modes.states, strict=True))[1:]:
        if state is not None and p > _LEAST:
            moved = _placed(state) @ np.linalg.inv(here)
            found.append({"probability": float(p), "matrix": moved.T.ravel().tolist()})
    return found


def _placed(state: ObjectState) -> Float[np.ndarray, "4 4"]:
    """T_world_object with its scale: from canonical units to metres in the world."""
    return state.T_world_object.matrix() @ np.diag([*state.scale, 1.0])


def _errors(path: Path) -> dict[int, dict[str, Any]]:
    try:
        return {entry["id"]: entry for entry in json.loads(path.read_text())["objects"]}
    except FileNotFoundError:
        return {}
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise MapError(f"{path}: not a readable list of errors ({error}); map the scan again") from error


def _points(
    points_world: Float[np.ndarray, "n 3"], colors: Float[np.ndarray, "n 3"] | None
) -> dict[str, str]:
    """At most `_POINTS` of them, evenly taken, in single precision, and their colours as bytes."""
    kept = np.flatnonzero(np.isfinite(points_world).all(axis=1))
    kept = kept[:: max(1, -(-len(kept) // _POINTS))]
    rgb = np.full((len(kept), 3), 0.6) if colors is None else colors[kept]
    positions = np.ascontiguousarray(points_world[kept], "<f4").tobytes()
    return {
        "positions": _base64(positions),
        "colors": _base64(np.round(255 * rgb.clip(0, 1)).astype(np.uint8).tobytes()),
    }


def _scale() -> list[str]:
    return [to_hex(color) for color in sigma_colormap()(np.linspace(0, 1, 9))]


def _jpeg(rgb: np.ndarray) -> str:
    done, data = cv2.imencode(".jpg", cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, 85])
    assert done
    return _base64(data.tobytes())


def _base64(data: bytes) -> str:
    return base64.b64encode(data).decode("ascii")
