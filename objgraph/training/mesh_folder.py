"""Which meshes of a folder a prior is evaluated on."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from objgraph.errors import EvaluationError
from objgraph.priors.shape_prior import ShapePrior
from objgraph.training.index import read_index
from objgraph.training.mesh_files import SUFFIXES, list_meshes

Choice = Literal["heldout", "all", "default"]


@dataclass(frozen=True)
class ChosenMeshes:
    """Mesh files, and in words which they are."""

    folder: Path
    names: tuple[str, ...]
    """Relative to the folder."""
    chosen: str


def choose_meshes(folder: Path, category: str, prior: ShapePrior, choice: Choice = "default") -> ChosenMeshes:
    """All meshes of a folder, or what its `index.json` lists for the category, or what the prior has not seen of that.

    By default those that the prior's card names as held out, where the index has any of them; else all.

    Raises:
        EvaluationError: there is no such folder, it has no mesh, or nothing in it is held out though asked for.
        PriorError: its index is damaged or has no mesh of the category.
    """
    if not folder.is_dir():
        raise EvaluationError(f"{folder} is no folder: give one that holds meshes ({', '.join(SUFFIXES)})")
    if not (folder / "index.json").is_file():
        names = list_meshes(folder, category)
        if not names:
            raise EvaluationError(f"{folder} holds no mesh ({', '.join(SUFFIXES)}), nor an index.json")
        if choice == "heldout":
            raise EvaluationError(f"{folder} has no index.json that would tell which meshes are held out")
        return ChosenMeshes(
            folder, tuple(names), "every mesh file in the folder, or in its subfolder of that name"
        )
    listed = [entry.file for entry in read_index(folder, category)]
    held = _held_out(prior.card)
    unseen = tuple(name for name in listed if name in held)
    if choice == "heldout" and not unseen:
        raise EvaluationError(
            f"{folder / 'index.json'} lists no {category} that the prior's card names as held out: "
            f"give --all, or the prior that was trained on this folder"
        )
    if choice == "all" or not unseen:
        return ChosenMeshes(folder, tuple(listed), f"every {category} of index.json")
    return ChosenMeshes(folder, unseen, f"the {category} meshes of index.json that training held out")


def _held_out(card: dict[str, Any]) -> set[str]:
    heldout = card.get("heldout")
    return set(heldout.get("collected", ())) if isinstance(heldout, dict) else set()


def write_json(document: dict[str, Any], path: Path) -> None:
    """Write atomically; a value that is not finite would be no JSON and is refused.

    Raises:
        EvaluationError: the file cannot be written.
    """
    temporary = path.with_name(f".{path.name}.tmp")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        temporary.write_text(json.dumps(document, indent=2, allow_nan=False) + "\n")
        temporary.replace(path)
    except OSError as error:
        raise EvaluationError(f"{path} cannot be written: {error}") from error
    finally:
        temporary.unlink(missing_ok=True)
