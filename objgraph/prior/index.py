"""The index of a folder of collected meshes, and which of them are held out."""

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from objgraph.errors import PriorError


@dataclass(frozen=True)
class CadMesh:
    """A collected mesh's entry in `index.json`."""

    file: str
    group: str
    licence: str
    attribution: str
    source: str
    size: tuple[float, float, float] | None
    """Metric extents where the source has them."""


def read_index(folder: Path, category: str) -> list[CadMesh]:
    """The entries of a category in a folder's `index.json`.

    Raises:
        PriorError: it is missing, damaged or has no mesh of the category; the message names it.
    """
    path = folder / "index.json"
    try:
        entries = json.loads(path.read_text())["meshes"]
        meshes = [
            CadMesh(
                file=entry["file"],
                group=entry["group"],
                licence=entry["licence"],
                attribution=entry["attribution"],
                source=entry["source_repo"],
                size=None if entry["size_m"] is None else tuple(entry["size_m"]),
            )
            for entry in entries
            if entry["category"] == category
        ]
    except OSError as error:
        raise PriorError(f"{path} cannot be read: give the folder that holds index.json") from error
    except (ValueError, KeyError, TypeError) as error:
        raise PriorError(f"{path} is no mesh index: {error!r}") from error
    if not meshes:
        raise PriorError(f"{path} has no mesh of category {category!r}")
    return meshes


def heldout_groups(meshes: Sequence[CadMesh], share: float) -> set[str]:
    """Groups held out: in an order that only their names decide, until they hold the share of the meshes."""
    groups: dict[str, int] = {}
    for mesh in meshes:
        groups[mesh.group] = groups.get(mesh.group, 0) + 1
    ordered = sorted(groups, key=lambda group: hashlib.sha256(group.encode()).hexdigest())
    chosen: set[str] = set()
    count = 0
    for group in ordered:
        if count >= share * len(meshes):
            break
        chosen.add(group)
        count += groups[group]
    return chosen
