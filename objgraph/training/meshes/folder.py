"""Which meshes of some folders a prior is evaluated on."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from objgraph.atomic import write_file
from objgraph.errors import EvaluationError
from objgraph.priors.shape_prior import ShapePrior
from objgraph.training.meshes.files import SUFFIXES, list_meshes
from objgraph.training.meshes.index import NotListedError, read_index
from objgraph.training.meshes.solid import require_libraries

Choice = Literal["heldout", "all", "default"]


@dataclass(frozen=True)
class ChosenMeshes:
    """Mesh files, and in words which they are."""

    folders: tuple[Path, ...]
    names: tuple[str, ...]
    """Relative to their folder, after the name of which where there are several."""
    paths: tuple[Path, ...]
    chosen: str


def choose_meshes(
    folders: Sequence[Path], category: str, prior: ShapePrior, choice: Choice = "default"
) -> ChosenMeshes:
    """All meshes of folders, or what each's `index.json` lists for the category, or what the prior has not seen of that.

    By default those that the prior's card names as held out, where a folder has any of them; else all. An index that lists none
    of the category is passed over, if another folder has some.

    Raises:
        EvaluationError: there is no such folder, it has no mesh, nothing is held out though asked for, or two folders of one
            name have meshes of one name.
        PriorError: an index is damaged, none has a mesh of the category, or the extra `train` is not installed.
    """
    if not folders:
        raise EvaluationError("no folder of meshes is given: name one")
    require_libraries()
    parts, missing = [], []
    for folder in folders:
        try:
            parts.append(_of_folder(folder, category, prior, choice))
        except NotListedError as error:
            missing.append(error)
    if not parts:
        raise missing[0]
    several = len(folders) > 1
    paths = tuple(folder / name for folder, names, _ in parts for name in names)
    labels = tuple(
        f"{folder.name}/{name}" if several else name for folder, names, _ in parts for name in names
    )
    if len(set(labels)) < len(labels):
        raise EvaluationError(f"{', '.join(map(str, folders))}: rename one, their meshes have the same names")
    return ChosenMeshes(tuple(folders), labels, paths, "; ".join(dict.fromkeys(words for *_, words in parts)))


def _of_folder(
    folder: Path, category: str, prior: ShapePrior, choice: Choice
) -> tuple[Path, tuple[str, ...], str]:
    """The folder, its meshes, and in words which they are."""
    if not folder.is_dir():
        raise EvaluationError(f"{folder} is no folder: give one that holds meshes ({', '.join(SUFFIXES)})")
    if (index := folder / "index.json").is_file():
        place, every = str(index), f"every {category} of index.json"
        names = [entry.file for entry in read_index(folder, category)]
    else:
        place = f"{folder}, which has no index.json,"
        every = "every mesh file in the folder, or in its subfolder of that name"
        names = list_meshes(folder, category)
    if not names:
        raise EvaluationError(f"{folder} holds no mesh ({', '.join(SUFFIXES)}), nor an index.json")
    held = _held_out(prior.card)
    unseen = tuple(name for name in names if name in held)
    if choice == "heldout" and not unseen:
        raise EvaluationError(
            f"{place} lists no {category} that the prior's card names as held out: "
            f"give --all, or the prior that was trained on this folder"
        )
    if choice == "all" or not unseen:
        return folder, tuple(names), every
    return folder, unseen, f"the {category} meshes that training held out"


def _held_out(card: dict[str, Any]) -> set[str]:
    """The meshes that a prior's card names as held out; none where it names none."""
    try:
        return set(card["heldout"]["collected"])
    except (KeyError, TypeError):
        return set()


def trained_on(card: dict[str, Any]) -> set[str]:
    """The meshes that a prior's card names as those it was trained on; none where it names none."""
    try:
        return {name for entry in card["data"]["collected"] for name in entry["files"]}
    except (KeyError, TypeError):
        return set()


def write_json(document: dict[str, Any], path: Path) -> None:
    """Write atomically; a value that is not finite would be no JSON and is refused.

    Raises:
        EvaluationError: the file cannot be written.
    """
    write_file(path, (json.dumps(document, indent=2, allow_nan=False) + "\n").encode(), EvaluationError)
