"""A map's folder: one JSON document beside each object's mesh (GLB) and joint covariance (safetensors), committed at once.

These files have their content's hash in their names, so a new one never overwrites one that the old document
names; the document is replaced last. A crash at any moment leaves the old map or the new one, whole. One process at a time
writes into a folder.
"""

import fcntl
import hashlib
import json
import os
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import safetensors.numpy
import trimesh
from jaxtyping import Float, Int, UInt8

from objgraph.atomic import write_file
from objgraph.checked import parse_json
from objgraph.errors import MapError
from objgraph.geometry.mesh_data import parse_scene

DOCUMENT = "map.json"
EVALUATION = "evaluation.json"
"""Errors of the objects that have ground truth, beside the map."""
MESH, JOINT = ".glb", ".safetensors"
"""What the names of an object's files end with."""
FILES = {"mesh": MESH, "joint_covariance": JOINT}
"""The fields of an object's entry that name a file."""
_OBJECT = re.compile(rf"object_-?\d+_[0-9a-f]{{8}}({re.escape(MESH)}|{re.escape(JOINT)})")
"""Names that `surface_name` and `covariance_name` give."""
_COVARIANCE = "covariance"
_SIGMA = "_SIGMA"
"""GLB's name of the attribute that holds each vertex's standard deviation in metres."""


class Surface(NamedTuple):
    """A mesh as it lies in a GLB file; GLB holds single precision."""

    vertices: Float[np.ndarray, "v 3"]
    faces: Int[np.ndarray, "f 3"]
    sigma: Float[np.ndarray, "v"] | None


def encode_surface(surface: Surface, colors: UInt8[np.ndarray, "v 3"] | None) -> bytes:
    """The bytes of a GLB file with the surface, its colours, and its sigma as the attribute `_SIGMA`."""
    mesh = trimesh.Trimesh(surface.vertices, surface.faces, vertex_colors=colors, process=False)
    if surface.sigma is not None:
        mesh.vertex_attributes[_SIGMA] = surface.sigma.astype(np.float32)
    data = mesh.export(file_type="glb")
    if not isinstance(data, bytes):
        raise MapError(f"a mesh of {len(surface.vertices)} vertices could not be written as GLB")
    return data


def read_surface(path: Path) -> Surface:
    """The surface in a GLB file that `encode_surface` wrote.

    Raises:
        MapError: the file is missing, truncated, or holds something else than one triangle mesh.
    """
    try:
        (mesh,) = parse_scene(path.read_bytes(), "glb").geometry.values()
        sigma = mesh.vertex_attributes.get(_SIGMA)
        vertices, faces = np.array(mesh.vertices, float), np.array(mesh.faces, np.int64)
    except FileNotFoundError as error:
        raise MapError(f"{path}: the map names this mesh but it is not there; save the map again") from error
    except Exception as error:  # trimesh raises whatever the broken bytes make it stumble over
        raise MapError(f"{path}: not a GLB file with one triangle mesh ({error})") from error
    return Surface(vertices, faces, None if sigma is None else np.array(sigma, float).reshape(-1))


def encode_covariance(matrix: Float[np.ndarray, "d d"]) -> bytes:
    """The bytes of a safetensors file with the matrix, in double precision."""
    return safetensors.numpy.save({_COVARIANCE: np.ascontiguousarray(matrix, dtype=np.float64)})


def read_covariance(path: Path) -> Float[np.ndarray, "d d"]:
    """The matrix in a file that `encode_covariance` wrote.

    Raises:
        MapError: the file is missing, truncated, or holds something else.
    """
    try:
        tensors = safetensors.numpy.load(path.read_bytes())
        return tensors[_COVARIANCE]
    except FileNotFoundError as error:
        raise MapError(
            f"{path}: the map names this covariance but it is not there; save the map again"
        ) from error
    except Exception as error:  # safetensors has an error type of its own for each way to be broken
        raise MapError(f"{path}: not a safetensors file with one covariance ({error})") from error


def surface_name(identifier: int, data: bytes) -> str:
    """The file name of object `identifier`'s mesh."""
    return f"object_{identifier}_{hashlib.sha256(data).hexdigest()[:8]}{MESH}"


def covariance_name(identifier: int, data: bytes) -> str:
    """The file name of object `identifier`'s joint covariance."""
    return f"object_{identifier}_{hashlib.sha256(data).hexdigest()[:8]}{JOINT}"


def read_document(folder: Path) -> dict[str, Any]:
    """The map's JSON document.

    Raises:
        MapError: there is none, or it is no JSON object.
    """
    path = folder / DOCUMENT
    try:
        document = parse_json(path.read_bytes())
    except FileNotFoundError as error:
        raise MapError(f"{path}: there is no map here; give the folder that a map was saved into") from error
    except (OSError, ValueError) as error:
        raise MapError(f"{path}: not a readable JSON document ({error})") from error
    if not isinstance(document, dict):
        raise MapError(f"{path}: holds a {type(document).__name__} where a map's object was expected")
    return document


def commit(folder: Path, document: Mapping[str, Any], files: Mapping[str, bytes]) -> None:
    """Write the objects' files, then replace the document, then remove the files of objects that it does not name.

    The errors of an earlier map go before it does; other files in the folder are left alone.

    Raises:
        MapError: the folder cannot be written, or the document holds a number JSON does not have.
    """
    try:
        text = json.dumps(document, indent=1, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise MapError(f"{folder / DOCUMENT}: the map cannot be written as JSON ({error})") from error
    try:
        with _alone_in(folder):
            for name, data in files.items():
                write_file(folder / name, data, MapError)
            (folder / EVALUATION).unlink(missing_ok=True)
            write_file(folder / DOCUMENT, text.encode(), MapError)
            for path in folder.iterdir():
                if _OBJECT.fullmatch(path.name) and path.name not in files:
                    path.unlink(missing_ok=True)
    except OSError as error:
        raise MapError(f"{folder}: the map cannot be written here ({error})") from error


@contextmanager
def _alone_in(folder: Path) -> Iterator[None]:
    """Keep out who else saves a map here: each would remove the files that the other has just written."""
    folder.mkdir(parents=True, exist_ok=True)
    handle = os.open(folder, os.O_RDONLY)
    try:
        with suppress(OSError):  # not every file system has locks
            fcntl.flock(handle, fcntl.LOCK_EX)
        yield
    finally:
        os.close(handle)


def is_plain_name(name: Any, end: str) -> bool:
    """Whether this is a file name that stays inside the map's folder and ends so."""
    return (
        isinstance(name, str) and name == os.path.basename(name) and "\\" not in name and name.endswith(end)
    )
