"""Tensors with JSON metadata in one safetensors file, replaced atomically."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import Tensor, nn

from objgraph.atomic import write_file
from objgraph.checked import parse_json
from objgraph.errors import PriorError

C = TypeVar("C")
N = TypeVar("N", bound=nn.Module)
_MOST = 4096
"""Units of a layer, layers, and all other settings of a network."""
_SMALL = 10**7
"""Weights that any memory holds: what is wrong with them is for others to say."""


def save_tensors(tensors: dict[str, Tensor], metadata: dict, path: Path) -> None:
    """Write tensors with JSON metadata; a process killed meanwhile leaves the old file whole.

    Raises:
        PriorError: the file cannot be written.
    """
    whole = {name: tensor.detach().contiguous().clone() for name, tensor in tensors.items()}
    write_file(path, save(whole, {"json": json.dumps(metadata)}), PriorError)


def loaded_network(kind: Callable[[C], N], config: C, weights: dict[str, Tensor]) -> N:
    """The network that a file's settings describe, with its weights.

    Raises:
        ValueError: it is larger than the weights, so that memory may not hold it.
        RuntimeError: the weights are of another network.
    """
    check_size(kind, config, weights)
    with torch.random.fork_rng(devices=[]):  # first weights are drawn: the caller's generator stays as it was
        network = kind(config)
    network.load_state_dict(weights)
    return network


def check_size(kind: Callable[[C], nn.Module], config: C, weights: dict[str, Tensor]) -> None:
    """Raises ValueError where the settings describe a network that is larger than the weights."""
    numbers = [
        item for value in vars(config).values() for item in (value if isinstance(value, tuple) else [value])
    ]
    if len(numbers) > _MOST or not all(0 <= item <= _MOST for item in numbers if isinstance(item, int)):
        raise ValueError(f"a network of sizes {numbers[:10]} is none")
    with torch.device("meta"):  # nothing is allocated
        size = sum(value.numel() for value in kind(config).state_dict().values())
    if size > _SMALL and size > sum(value.numel() for value in weights.values()):
        raise ValueError(f"describes a network of {size} weights, more than it holds")


def load_tensors(path: Path) -> tuple[dict[str, Tensor], dict]:
    """Tensors and metadata of a file that `save_tensors` wrote.

    Raises:
        PriorError: it is missing, truncated, or some other file; the message names it.
    """
    try:
        with safe_open(path, framework="pt") as file:
            metadata = parse_json((file.metadata() or {})["json"].encode())
            # copies: the file's own memory changes with the file, if another is copied over it
            tensors = {name: file.get_tensor(name).clone() for name in file.keys()}  # noqa: SIM118
    except (OSError, SafetensorError, ValueError, KeyError) as error:
        raise PriorError(f"{path} is missing, damaged, or not written by objgraph: {error}") from error
    if not isinstance(metadata, dict):
        raise PriorError(f"{path} is not written by objgraph: its metadata is no JSON object")
    return tensors, metadata
