"""The index of a folder of collected meshes, and which of them are held out."""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_type_hints

from objgraph.checked import check_fields, inside, numbers, parse_json
from objgraph.errors import PriorError
from objgraph.training.meshes.files import SUFFIXES, list_meshes

HELDOUT_SHARE = 0.2
"""Of every source's meshes, for evaluation alone."""


class NotListedError(PriorError):
    """An index is whole and lists no mesh of the category."""


@dataclass(frozen=True)
class CadMesh:
    """A collected mesh's entry in `index.json`."""

    folder: Path
    file: str
    """Relative to the folder."""
    group: str
    licence: str
    attribution: str
    source: str
    size: tuple[float, float, float] | None
    """Metric extents where the source has them."""
    maker: str = "people"
    """"people" or "generator"."""
    kind: str = ""
    """Of a generator's meshes, which of its factories made them."""
    split: str = "train"
    """What the index itself says: the group of all but "train" is held out, that of "train" as `heldout_groups` draws."""
    typical: bool = False
    """Whether its size is that of its kind, not of the real thing."""

    @property
    def path(self) -> Path:
        return self.folder / self.file


def read_index(folder: Path, category: str) -> list[CadMesh]:
    """The entries of a category in a folder's `index.json`; without one, all its mesh files, of unknown licences.

    Raises:
        NotListedError: it has no mesh of the category.
        PriorError: it is damaged, or the folder has no mesh; the message names it.
    """
    path = folder / "index.json"
    if not path.exists():
        return _unlisted(folder, category)
    try:
        entries = parse_json(path.read_bytes())["meshes"]
        meshes = [_mesh(folder, entry) for entry in entries if entry["category"] == category]
    except OSError as error:
        raise PriorError(f"{path} cannot be read: {error}") from error
    except (ValueError, KeyError, TypeError) as error:
        raise PriorError(f"{path} is no mesh index: {error!r}") from error
    if not meshes:
        raise NotListedError(f"{path} has no mesh of category {category!r}")
    return meshes


def _mesh(folder: Path, entry: dict[str, Any]) -> CadMesh:
    """The mesh of an entry; raises KeyError, TypeError or ValueError where it is none or lies elsewhere."""
    size = entry["size_m"]
    mesh = CadMesh(
        folder=folder,
        file=str(inside(folder, entry["file"]).relative_to(folder)),
        group=entry["group"],
        licence=entry["licence"],
        attribution=entry["attribution"],
        source=entry["source_repo"],
        size=None if size is None else tuple(numbers(size, 3).tolist()),
        maker=entry.get("made_by", "people"),
        kind=entry.get("kind", ""),
        split=entry.get("split", "train"),
        typical=entry.get("size_typical") or False,
    )
    check_fields(vars(mesh), get_type_hints(CadMesh))
    if mesh.size is not None and min(mesh.size) <= 0:
        raise ValueError(f"{mesh.file}: extents of {mesh.size} m")
    return mesh


def _unlisted(folder: Path, category: str) -> list[CadMesh]:
    """Mesh files of a folder without an index, equal ones a group, by the first one's name, their folders the sources."""
    files = list_meshes(folder, category)
    if not files:
        raise PriorError(f"{folder} holds neither an index.json nor a mesh ({', '.join(SUFFIXES)})")
    first: dict[bytes, str] = {}
    return [
        CadMesh(
            folder,
            file,
            group=first.setdefault(_content(folder / file), file),
            licence="unknown",
            attribution="unknown",
            source=str(Path(file).parent),
            size=None,
        )
        for file in files
    ]


def _content(path: Path) -> bytes:
    """What tells a file from others that are not equal to it; of one that cannot be read its name."""
    try:
        return hashlib.sha256(path.read_bytes()).digest()
    except OSError:
        return str(path).encode()


def heldout_groups(meshes: Sequence[CadMesh], share: float) -> set[str]:
    """Groups held out: those that the index says, and of every source and kind, in an order that only the names decide, as many
    more as make at least the share of its meshes.

    Sources of one group each are drawn from together.
    """
    said = {mesh.group for mesh in meshes if mesh.split != "train"}
    sources: dict[tuple[str, str], dict[str, int]] = {}
    for mesh in meshes:
        counts = sources.setdefault((mesh.source, mesh.kind), {})
        counts[mesh.group] = counts.get(mesh.group, 0) + 1
    pools = [counts for counts in sources.values() if len(counts) > 1]
    pools.append({group: n for counts in sources.values() if len(counts) == 1 for group, n in counts.items()})
    return {group for counts in pools for group in _drawn(counts, share, said)}


def _drawn(counts: dict[str, int], share: float, said: set[str]) -> list[str]:
    """The groups of one source that are held out, those that are said to be first."""
    chosen = [group for group in counts if group in said]
    for group in sorted(counts.keys() - said, key=lambda group: hashlib.sha256(group.encode()).hexdigest()):
        if sum(counts[g] for g in chosen) >= share * sum(counts.values()):
            break
        chosen.append(group)
    return chosen
