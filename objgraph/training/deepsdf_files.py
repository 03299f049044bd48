"""Experiment folders of the DeepSDF release: `specs.json`, `ModelParameters/*.pth`, `LatentCodes/*.pth`.

The layout is that of the public implementation of Park et al., "DeepSDF", CVPR 2019; systems built on it ship
their priors in the same one. Checkpoints are read as plain tensors: a file that would have to run code is refused.
"""

import pickle
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from factors.deepsdf import DeepSdfConfig, DeepSdfDecoder
from factors.errors import FactorError
from objgraph.checked import parse_json
from objgraph.errors import PriorError
from objgraph.priors.tensors import check_size

ARCHITECTURE = "deep_sdf_decoder"
"""The only `NetworkArch` that is understood."""


@dataclass(frozen=True)
class Experiment:
    """What one checkpoint of a training holds."""

    decoder: DeepSdfDecoder
    """In the source's own units."""
    codes: Float[np.ndarray, "s l"] | None
    """Of the training shapes, where the folder has them."""
    code_sigma: float
    """Standard deviation of a code's entries before training: `CodeInitStdDev` / sqrt(length)."""
    epoch: int | None
    description: str
    model: Path
    """The file that the weights are from."""


def load_experiment(folder: Path, checkpoint: str = "latest") -> Experiment:
    """Read a checkpoint (`latest`, or an epoch's number) of an experiment folder.

    Raises:
        PriorError: a file is missing, damaged, would run code, or does not fit the others; the message names it.
    """
    specs = folder / "specs.json"
    document = _read_json(specs)
    config = _network(specs, document)
    model = folder / "ModelParameters" / f"{checkpoint}.pth"
    if not model.is_file():
        raise PriorError(f"{model} is missing; {_checkpoints(model.parent)}")
    content = _read_tensors(model)
    weights = content.get("model_state_dict", content)
    if not isinstance(weights, dict) or not weights:
        raise PriorError(f"{model} holds no model_state_dict")
    codes = folder / "LatentCodes" / f"{checkpoint}.pth"
    epoch, sigma = content.get("epoch"), document.get("CodeInitStdDev", 1.0)
    if not isinstance(sigma, int | float) or not sigma > 0:
        raise PriorError(f"{specs}: CodeInitStdDev {sigma!r} is no positive number")
    description = document.get("Description", "")
    return Experiment(
        decoder=_decoder(model, config, weights),
        codes=_codes(codes, config.code_length) if codes.is_file() else None,
        code_sigma=float(sigma) / config.code_length**0.5,
        epoch=epoch if isinstance(epoch, int) else None,
        description=" ".join(map(str, description)) if isinstance(description, list) else str(description),
        model=model,
    )


def _read_json(path: Path) -> dict[str, Any]:
    try:
        document = parse_json(path.read_bytes())
    except OSError as error:
        raise PriorError(f"{path} cannot be read: give the folder of a DeepSDF experiment") from error
    except ValueError as error:
        raise PriorError(f"{path} is no JSON: {error}") from error
    if not isinstance(document, dict):
        raise PriorError(f"{path} is no JSON object")
    return document


def _network(path: Path, document: dict[str, Any]) -> DeepSdfConfig:
    """The network's shape as `specs.json` has it."""
    architecture = document.get("NetworkArch", ARCHITECTURE)
    if architecture != ARCHITECTURE:
        raise PriorError(f"{path}: NetworkArch {architecture!r} is not known; only {ARCHITECTURE!r} is")
    try:
        length, network = document["CodeLength"], document["NetworkSpecs"]
        dims = network["dims"]
    except (KeyError, TypeError) as error:
        raise PriorError(
            f"{path}: CodeLength, NetworkSpecs and its dims are needed ({error} is missing)"
        ) from error
    lists = {"dims": dims, **{key: network.get(key) or [] for key in ("latent_in", "norm_layers")}}
    for key, value in {"CodeLength": [length], **lists}.items():
        if not isinstance(value, list) or not all(type(item) is int and item >= 0 for item in value):
            raise PriorError(f"{path}: {key} holds {value!r}, not whole numbers")
    norms = () if network.get("weight_norm") else tuple(i for i in lists["norm_layers"] if i < len(dims))
    return DeepSdfConfig(
        code_length=length,
        dims=tuple(dims),
        latent_in=tuple(lists["latent_in"]),
        xyz_in_all=bool(network.get("xyz_in_all")),
        layer_norm=norms,
        tanh=2 if network.get("use_tanh") else 1,
    )


def _read_tensors(path: Path) -> dict[str, Any]:
    """The dictionary of a checkpoint; nothing in it is run."""
    try:
        content = torch.load(path, map_location="cpu", weights_only=True)
    except pickle.UnpicklingError as error:
        found = re.search(r"GLOBAL (\S+)", str(error))
        what = f" ({found.group(1)})" if found else ""
        raise PriorError(
            f"{path} is refused: it holds more than tensors{what} and reading it could run code, or it is damaged"
        ) from error
    except Exception as error:  # a damaged file raises whatever its parsing runs into
        reason = str(error).partition("\n")[0]
        raise PriorError(f"{path} is no checkpoint of tensors, or damaged: {reason!r}") from error
    if not isinstance(content, dict):
        raise PriorError(f"{path} holds a {type(content).__name__}, not the dictionary of a checkpoint")
    return content


def _decoder(path: Path, config: DeepSdfConfig, weights: dict[str, Any]) -> DeepSdfDecoder:
    """The decoder with the checkpoint's weights, weight norm folded."""
    try:
        given = {str(key).removeprefix("module."): value for key, value in weights.items()}
        check_size(
            DeepSdfDecoder, config, {key: value for key, value in given.items() if isinstance(value, Tensor)}
        )
        decoder = DeepSdfDecoder(config)
    except (FactorError, RuntimeError, ValueError) as error:
        raise PriorError(f"{path}: specs.json describes no network that can be built: {error}") from error
    used: set[str] = set()

    def take(key: str) -> Tensor:
        value = given.get(key)
        if not isinstance(value, Tensor):
            raise PriorError(f"{path}: {key} is missing; does specs.json belong to this checkpoint?")
        used.add(key)
        return _plain(path, key, value).float()

    state: dict[str, Tensor] = {}
    for i in range(len(config.dims) + 1):
        weight = _folded(path, f"lin{i}", given, take)
        state |= _split(decoder, path, i, weight)
        state[f"bias.{i}"] = take(f"lin{i}.bias")
        if i in config.layer_norm:
            state |= {f"norm.{i}.{part}": take(f"bn{i}.{part}") for part in ("weight", "bias")}
    if left := sorted(set(given) - used):
        raise PriorError(
            f"{path}: {', '.join(left[:4])} has no place in the network of specs.json; is it of another one?"
        )
    for key, value in state.items():
        if not torch.isfinite(value).all():
            raise PriorError(f"{path}: the weights of {key} are not finite")
    try:
        decoder.load_state_dict(state)
    except RuntimeError as error:
        raise PriorError(f"{path} does not fit the network of specs.json: {error}") from error
    return decoder.requires_grad_(False).eval()


def _plain(path: Path, what: str, value: Tensor) -> Tensor:
    """A tensor of real numbers, whether it was trained or not; raises PriorError where it is of another kind."""
    other = value.is_complex() or value.is_quantized or value.is_nested or value.is_meta
    if other or value.layout != torch.strided:
        raise PriorError(f"{path}: {what} is no plain tensor of real numbers")
    return value.detach()


def _folded(path: Path, layer: str, given: dict[str, Any], take: Callable[[str], Tensor]) -> Tensor:
    """A layer's weight, g * v / |v| where it was trained with weight norm."""
    pairs = (
        ("weight_g", "weight_v"),
        ("parametrizations.weight.original0", "parametrizations.weight.original1"),
    )
    for g, v in pairs:
        if f"{layer}.{v}" in given:
            direction, length = take(f"{layer}.{v}"), take(f"{layer}.{g}")
            if direction.dim() != 2 or length.numel() != len(direction):
                raise PriorError(
                    f"{path}: {layer}'s {g} of {tuple(length.shape)} does not fit its {v} of {tuple(direction.shape)}"
                )
            return direction * (length.reshape(-1, 1) / direction.norm(dim=1, keepdim=True))
    return take(f"{layer}.weight")


def _split(decoder: DeepSdfDecoder, path: Path, layer: int, weight: Tensor) -> dict[str, Tensor]:
    """A layer's weight by what its columns belong to: the layer before, the code, the point."""
    name = str(layer)
    state = decoder.state_dict()
    parts = [
        key for part in ("hidden", "from_code", "from_point") if (key := f"{part}.{name}.weight") in state
    ]
    widths = [state[key].shape[1] for key in parts]
    wanted = (len(decoder.bias[layer]), sum(widths))
    if tuple(weight.shape) != wanted:
        raise PriorError(
            f"{path}: lin{layer} has a weight of {tuple(weight.shape)}, specs.json asks for {wanted} "
            f"(code length {decoder.code_length})"
        )
    return dict(zip(parts, weight.split(widths, dim=1), strict=True))


def _codes(path: Path, length: int) -> Float[np.ndarray, "s l"]:
    """The training shapes' codes: a tensor, or the state of an embedding."""
    codes = _read_tensors(path).get("latent_codes")
    if isinstance(codes, dict):
        codes = codes.get("weight")
    if not isinstance(codes, Tensor):
        raise PriorError(f"{path} holds no latent_codes")
    if codes.numel() == 0 or codes.shape[-1] != length:
        raise PriorError(f"{path}: codes of shape {tuple(codes.shape)} are not of length {length}")
    found = _plain(path, "latent_codes", codes).reshape(-1, length).double().numpy()
    if not np.isfinite(found).all():
        raise PriorError(f"{path}: a code is not finite")
    return found


def _checkpoints(folder: Path) -> str:
    names = sorted(path.stem for path in folder.glob("*.pth"))
    return f"there are {', '.join(names)}" if names else f"{folder} has no checkpoint"
