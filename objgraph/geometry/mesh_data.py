"""Triangles from the bytes of a mesh file, and from nothing else: no material, picture or other file that it names is read."""

import struct
from io import BytesIO
from typing import Any

import numpy as np
import trimesh
from jaxtyping import Float

from objgraph.checked import parse_json

MOST_FACES = 10**7
"""Of a file, and as many vertices."""
_HEADER = struct.Struct("<4sIIII")
"""Of a GLB file: its mark, version and length, then the length and kind of the first part, which is JSON."""


def parse_mesh(data: bytes, kind: str) -> trimesh.Trimesh:
    """All triangles of a file of this kind ("ply", "obj", "stl", "off", "glb"), as they stand in it.

    Raises:
        ValueError: it is damaged, holds no triangles or too many, or a face names a vertex that there is not.
    """
    scene = parse_scene(data, kind)
    shown = [scene.graph[node][1] for node in scene.graph.nodes_geometry]
    if sum(len(getattr(scene.geometry[name], "faces", ())) for name in shown) > MOST_FACES:
        raise ValueError(f"shows more than {MOST_FACES} faces")
    try:
        mesh = scene.to_mesh()
        vertices, faces = np.asarray(mesh.vertices, float), np.asarray(mesh.faces)
    except Exception as error:  # trimesh stumbles over whatever a broken file makes of its parts
        raise ValueError(f"damaged ({error!r})") from error
    if not len(faces):
        raise ValueError("holds no faces")
    if vertices.ndim != 2 or vertices.shape[1] != 3 or faces.ndim != 2 or faces.shape[1] != 3:
        raise ValueError(f"vertices of {vertices.shape} and faces of {faces.shape} are no triangles")
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise ValueError(f"a face names a vertex outside of 0..{len(vertices) - 1}")
    return mesh


def parse_points(data: bytes, kind: str) -> Float[np.ndarray, "n 3"]:
    """The vertices of a file of this kind, be there faces or not; raises ValueError where there are none."""
    parts = [getattr(each, "vertices", ()) for each in parse_scene(data, kind).geometry.values()]
    points = np.concatenate([np.asarray(part, float).reshape(-1, 3) for part in parts or [()]])
    if not len(points):
        raise ValueError("holds no vertices")
    return points


def parse_scene(data: bytes, kind: str) -> trimesh.Scene:
    """What a file of this kind holds, unchecked but for the memory that it takes; raises ValueError where it is damaged."""
    try:
        if kind == "glb":
            _check_counts(data)
        return trimesh.load_scene(BytesIO(data), file_type=kind, process=False, skip_materials=True)
    except Exception as error:  # trimesh's readers raise whatever the broken bytes make them stumble over
        raise ValueError(f"damaged ({error!r})") from error


def _check_counts(data: bytes) -> None:
    """A GLB file of some bytes may ask for any number of vertices and show a mesh any number of times."""
    *_, length, _ = _HEADER.unpack_from(data)
    document: Any = parse_json(data[_HEADER.size : _HEADER.size + length])
    accessors = document.get("accessors", [])
    if sum(each["count"] for each in accessors) > 3 * MOST_FACES or any(
        each["count"] < 0 for each in accessors
    ):
        raise ValueError(f"asks for more than {3 * MOST_FACES} entries")
