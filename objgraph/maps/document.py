"""A mapped object as an entry of the map's JSON document, and back."""

from collections.abc import Iterable
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from objgraph.checked import typed
from objgraph.errors import CovarianceError, MapError
from objgraph.maps import files as map_files
from objgraph.maps.mapped_object import BOX_COVARIANCE_AXES, COVARIANCE_AXES, MappedObject, PriorReference
from objgraph.maps.other_estimate import OtherEstimate
from objgraph.trust.verdict import Trust

_AXES = {"covariance": list(COVARIANCE_AXES), "box_covariance": list(BOX_COVARIANCE_AXES)}
"""What the rows of a matrix are, told beside it."""
_IN_FILES = ("vertices", "faces", "vertex_sigma", "joint_covariance")
_JSON_FIELDS = tuple(f.name for f in fields(MappedObject) if f.name not in _IN_FILES)


def to_json(entry: MappedObject, mesh: str | None, joint: str | None) -> dict[str, Any]:
    """An object's entry in the document; `mesh` and `joint` name the files of its surface and joint covariance."""
    document = {name: getattr(entry, name) for name in _JSON_FIELDS}
    document = {k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in document.items()}
    document["views"] = list(entry.views)
    document["prior"] = _prior_to_json(entry.prior)
    document["trust"] = None if entry.trust is None else entry.trust.to_json()
    document["other"] = None if entry.other is None else entry.other.to_json()
    for name, axes in _AXES.items():
        document[f"{name}_axes"] = None if document[name] is None else axes
    document |= {"mesh": mesh, "joint_covariance": joint}
    return document


def _prior_to_json(prior: PriorReference | None) -> dict[str, Any] | None:
    if prior is None:
        return None
    return {"name": prior.name, "hash": prior.hash} | ({"fallback": True} if prior.fallback else {})


def from_json(document: Any, index: int, folder: Path) -> MappedObject:
    """The object that the document's `index`-th entry describes, with its surface from the folder.

    Raises:
        MapError: a field or the mesh is missing or broken; the message names it.
    """
    where = f"{folder / map_files.DOCUMENT}: objects[{index}]"
    if not isinstance(document, dict):
        raise MapError(f"{where} is no JSON object")
    require(document, (*_JSON_FIELDS, *(f"{name}_axes" for name in _AXES), *map_files.FILES), where)
    for name, axes in _AXES.items():
        if document[name] is not None and document[f"{name}_axes"] != axes:
            raise MapError(f"{where}: {name}_axes are not {axes}")
    given = {name: document[name] for name in _JSON_FIELDS}
    given["trust"] = _trust(given["trust"], where)
    try:
        given["prior"] = None if given["prior"] is None else typed(PriorReference, given["prior"])
    except TypeError as error:
        raise MapError(f"{where}: prior must have a name and a hash ({error})") from error
    for name, kind in (("views", list), ("seconds_by_stage", dict)):
        if not isinstance(given[name], kind):
            raise MapError(f"{where}: {name} is a {type(given[name]).__name__}")
    for name, end in map_files.FILES.items():
        if document[name] is not None and not map_files.is_plain_name(document[name], end):
            raise MapError(
                f"{where}: {name} {document[name]!r} is not the name of a {end} file in the map's folder"
            )
    if document["mesh"] is not None:
        surface = map_files.read_surface(folder / document["mesh"])
        given |= {"vertices": surface.vertices, "faces": surface.faces, "vertex_sigma": surface.sigma}
    if document["joint_covariance"] is not None:
        given["joint_covariance"] = map_files.read_covariance(folder / document["joint_covariance"])
    try:
        given["other"] = None if given["other"] is None else OtherEstimate.from_json(given["other"])
        return MappedObject(**given)
    except MapError as error:
        raise MapError(f"{where}: {error}") from error


def _trust(given: Any, where: str) -> Trust | None:
    try:
        if isinstance(given, dict) and isinstance(given.get("why"), list):
            given = {**given, "why": tuple(given["why"])}
        return None if given is None else typed(Trust, given)
    except (TypeError, CovarianceError) as error:
        raise MapError(f"{where}: trust is none ({error})") from error


def require(document: dict[str, Any], names: Iterable[str], where: str) -> None:
    """Raises `MapError` where a name is missing."""
    if missing := [name for name in names if name not in document]:
        raise MapError(f"{where}: {', '.join(missing)} missing; was this written by ObjectMap.save?")
