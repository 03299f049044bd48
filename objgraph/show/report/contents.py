"""What the page shows of a map, as JSON: the table's columns, each object's facts, meshes, ellipsoids and modes."""

import base64
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from jaxtyping import Float
from matplotlib.colors import to_hex

from objgraph.maps.colors import sigma_colormap, sigma_limit
from objgraph.maps.files import read_document
from objgraph.maps.object_map import ObjectMap
from objgraph.show.object_rows import (
    ERRORS,
    columns_of,
    error_row,
    errors_beside,
    object_row,
    remarks_of,
)
from objgraph.show.placement import LEVEL, box_of, centre_ellipsoid, headings_of, scaled_frame
from objgraph.show.raster import finite_points
from objgraph.show.report.views import ObjectPicture

_POINTS = 80_000


def map_contents(
    folder: Path,
    points_world: Float[np.ndarray, "n 3"] | None,
    colors: Float[np.ndarray, "n 3"] | None,
    pictures: Mapping[int, Sequence[ObjectPicture]],
) -> dict[str, Any]:
    """All of a saved map that its page shows; no number that JSON does not have.

    Raises:
        MapError: there is no map, it or the errors beside it are damaged, or points and colours do not fit.
    """
    object_map = ObjectMap.load(folder)
    files = {entry["id"]: entry.get("mesh") for entry in read_document(folder)["objects"]}
    errors = errors_beside(folder)
    limit = sigma_limit(entry.vertex_sigma for entry in object_map.objects)
    objects = []
    for entry in object_map.objects:
        mesh, box, ellipsoid = files[entry.id], box_of(entry), centre_ellipsoid(entry)
        objects.append(
            {
                "id": entry.id,
                "name": entry.name,
                "mapped": entry.status == "mapped",
                "row": object_row(entry, object_map.up_world) | error_row(errors.get(entry.id, {})),
                "remarks": remarks_of(entry),
                "mesh": _base64((folder / mesh).read_bytes()) if mesh else None,
                "ellipsoid": None if ellipsoid is None else _column_major(ellipsoid.matrix),
                "box": None
                if box is None
                else _column_major(scaled_frame(box.centre, box.rotation, box.extents)),
                "modes": [
                    {"probability": mode.probability, "matrix": _column_major(mode.moved_world)}
                    for mode in headings_of(entry)
                ],
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
        "columns": [each._asdict() for each in columns_of(errors)],
        "errors": ERRORS[0].label if errors else None,
        "objects": objects,
        "points": None if points_world is None else _points(points_world, colors),
        "sigma": None if limit is None else {"limit_cm": 100 * limit, "colors": _scale()},
    }


def _column_major(matrix: Float[np.ndarray, "4 4"]) -> list[float]:
    """As WebGL has matrices."""
    return matrix.T.ravel().tolist()


def _points(
    points_world: Float[np.ndarray, "n 3"], colors: Float[np.ndarray, "n 3"] | None
) -> dict[str, str]:
    """At most `_POINTS` of them, evenly taken, in single precision, and their colours as bytes."""
    points, colors = finite_points(points_world, colors)
    kept = slice(None, None, max(1, -(-len(points) // _POINTS)))
    rgb = np.full_like(points, 0.6) if colors is None else colors
    return {
        "positions": _base64(np.ascontiguousarray(points[kept], "<f4").tobytes()),
        "colors": _base64(np.round(255 * rgb[kept]).astype(np.uint8).tobytes()),
    }


def _scale() -> list[str]:
    return [to_hex(color) for color in sigma_colormap()(np.linspace(0, 1, 9))]


def _jpeg(rgb: np.ndarray) -> str:
    done, data = cv2.imencode(".jpg", cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, 85])
    assert done
    return _base64(data.tobytes())


def _base64(data: bytes) -> str:
    return base64.b64encode(data).decode("ascii")
