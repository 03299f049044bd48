"""Tensors with JSON metadata in one safetensors file, replaced atomically."""

import json
from pathlib import Path

from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import Tensor

from objgraph.atomic import write_file
from objgraph.errors import PriorError


def save_tensors(tensors: dict[str, Tensor], metadata: dict, path: Path) -> None:
    """Write tensors with JSON metadata; a process killed meanwhile leaves the old file whole.

    Raises:
        PriorError: the file cannot be written.
    """
    whole = {name: tensor.detach().contiguous().clone() for name, tensor in tensors.items()}
    write_file(path, save(whole, {"json": json.dumps(metadata)}), PriorError)


def load_tensors(path: Path) -> tuple[dict[str, Tensor], dict]:
    """Tensors and metadata of a file that `save_tensors` wrote.

    Raises:
        PriorError: it is missing, truncated, or some other file; the message names it.
    """
    try:
        with safe_open(path, framework="pt") as file:
            metadata = json.loads((file.metadata() or {})["json"])
            # copies: the file's own memory changes with the file, if another is copied over it
            tensors = {name: file.get_tensor(name).clone() for name in file.keys()}  # noqa: SIM118
    except (OSError, SafetensorError, ValueError, KeyError) as error:
        raise PriorError(f"{path} is missing, damaged, or not written by objgraph: {error}") from error
    if not isinstance(metadata, dict):
        raise PriorError(f"{path} is not written by objgraph: its metadata is no JSON object")
    return tensors, metadata
