"""The map's objects: meshes, boxes, ellipsoids, other headings, and their table."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr

from objgraph.geometry.frames import transformed
from objgraph.maps.colors import sigma_colors, sigma_limit
from objgraph.maps.mapped_object import MappedObject
from objgraph.maps.object_map import ObjectMap
from objgraph.show.object_rows import (
    Column,
    columns_of,
    error_row,
    errors_beside,
    object_row,
    remarks_of,
)
from objgraph.show.placement import box_of, centre_ellipsoid, headings_of
from objgraph.show.rerun_view import paths
from objgraph.show.rerun_view.shapes import ELLIPSOID, Rgb, box_shape, ellipsoid_shape, mesh_shape, world_axes

_GHOST: Rgb = (0, 114, 178)
"""Of other headings, as on the map's page."""


def log_objects(recording: rr.RecordingStream, object_map: ObjectMap, folder: Path) -> None:
    """All objects of the map that is saved in a folder, at all times, and their table with the errors beside it.

    Raises:
        MapError: the errors beside the map are damaged.
    """
    errors = errors_beside(folder)
    columns = columns_of(errors)
    recording.log(paths.WORLD, world_axes(object_map.up_world), static=True)
    limit = sigma_limit(entry.vertex_sigma for entry in object_map.objects)
    rows = []
    for i, entry in enumerate(object_map.objects):
        row = object_row(entry, object_map.up_world) | error_row(errors.get(entry.id, {}))
        rows.append((entry, row))
        _log_object(recording, entry, paths.object_color(i), limit)
        recording.log(paths.object_path(entry.name), _markdown(_facts(entry, row, columns)), static=True)
    recording.log(paths.TABLE, _markdown(_table(object_map, rows, columns)), static=True)


def _log_object(recording: rr.RecordingStream, entry: MappedObject, rgb: Rgb, limit: float | None) -> None:
    box, ellipsoid = box_of(entry), centre_ellipsoid(entry)
    if entry.vertices is not None and entry.faces is not None:
        sigma = entry.vertex_sigma
        colors = None if sigma is None or limit is None else sigma_colors(sigma, limit)
        mesh = mesh_shape(entry.vertices, entry.faces, colors, rgb if colors is None else None)
        recording.log(paths.object_path(entry.name, "mesh"), mesh, static=True)
        for heading in headings_of(entry):
            moved = transformed(heading.moved_world, entry.vertices)
            ghost = mesh_shape(moved, entry.faces, None, (*_GHOST, _opacity(heading.probability)))
            path = paths.object_path(entry.name, "other_headings", f"turned_{90 * heading.quarter}")
            recording.log(path, ghost, static=True)
    if box is not None:
        recording.log(paths.object_path(entry.name, "box"), box_shape(box, entry.name, rgb), static=True)
    if ellipsoid is not None:
        recording.log(
            paths.object_path(entry.name, "ellipsoid"), ellipsoid_shape(ellipsoid, ELLIPSOID), static=True
        )


def _opacity(probability: float) -> int:
    return round(255 * np.clip(0.15 + probability, 0, 0.6))


def _table(
    object_map: ObjectMap, rows: list[tuple[MappedObject, dict[str, Any]]], columns: list[Column]
) -> str:
    lines = [
        f"**{_escaped(object_map.scene)}**: {len(object_map.mapped)} of {len(rows)} objects mapped",
        "",
        _line([_label(column) for column in columns]),
        _line(["---"] * len(columns)),
        *(_line([_shown(row, column) for column in columns]) for _, row in rows),
        "",
    ]
    told = [(entry, remarks_of(entry)) for entry, _ in rows]
    return "\n".join(lines + [f"- {_escaped(e.name)}: {_escaped('; '.join(r))}" for e, r in told if r])


def _facts(entry: MappedObject, row: Mapping[str, Any], columns: list[Column]) -> str:
    """One object's row, turned upright."""
    known = [(_label(column), _shown(row, column)) for column in columns if row.get(column.key) is not None]
    lines = [f"**{_escaped(entry.name)}**", "", *(f"- {label}: {value}" for label, value in known)]
    return "\n".join(lines + [f"- {_escaped(remark)}" for remark in remarks_of(entry)])


def _label(column: Column) -> str:
    return f"{column.label}, {column.unit}" if column.unit else column.label


def _shown(row: Mapping[str, Any], column: Column) -> str:
    value = row.get(column.key)
    if value is None:
        return "-"
    return _escaped(value) if isinstance(value, str) else f"{value:.{column.digits}f}"


def _escaped(text: str) -> str:
    """Names come from data sets: one may hold what Markdown reads."""
    return "".join(f"\\{sign}" if sign in "\\`*_[]<>|#" else sign for sign in " ".join(text.split()))


def _line(cells: list[str]) -> str:
    return f"| {' | '.join(cells)} |"


def _markdown(text: str) -> rr.TextDocument:
    return rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN)
