"""A shape prior as one safetensors file: weights and code statistics as tensors, the model card as JSON."""

import hashlib
import json
import logging
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from factors import checks
from factors.code_mixture import CodeMixture
from factors.decoder import Decoder, DecoderConfig
from factors.deepsdf import DeepSdfConfig, DeepSdfDecoder
from factors.errors import FactorError
from factors.proportions import Proportions
from factors.sdf_decoder import SdfDecoder
from factors.superquadric import Superquadric, SuperquadricConfig
from objgraph.checked import check_fields, parse_json, typed
from objgraph.errors import PriorError
from objgraph.priors.first_guess import FirstGuess, FirstGuessConfig
from objgraph.priors.shape_prior import ShapePrior
from objgraph.priors.tensors import load_tensors, loaded_network, save_tensors

log = logging.getLogger(__name__)

FORMAT = "objgraph-prior-1"
FRAME = "y up, front at -z, bounding box centred (ShapeNetCore.v2's axes)"
SCALE = "bounding-box diagonal 1; distances in the same unit, negative inside"
BOX_SCALE = "every shape stretched to one box (tensor `box`); distances before the stretch, in box diagonals"


def save_prior(prior: ShapePrior, path: Path) -> None:
    """Write a prior atomically, with the hash of its tensors in the card.

    Raises:
        PriorError: it could not be loaded again, or the file cannot be written; the message names it.
    """
    tensors = {f"decoder.{name}": value for name, value in prior.decoder.state_dict().items()}
    tensors["code_mean"] = torch.from_numpy(np.asarray(prior.code_mean, np.float64))
    if prior.kinds is None:
        tensors["code_covariance"] = torch.from_numpy(np.asarray(prior.code_covariance, np.float64))
    else:
        tensors |= _tensors_of_kinds(prior.kinds)  # their covariance is that of all codes
    if prior.prototypes is not None:
        tensors["prototypes"] = torch.from_numpy(np.asarray(prior.prototypes, np.float64))
    if prior.box is not None:
        tensors["box"] = torch.from_numpy(np.asarray(prior.box, np.float64))
    if prior.proportions is not None:
        known = vars(prior.proportions).items()
        tensors |= {f"proportions.{name}": torch.from_numpy(value) for name, value in known}
    guess = {}
    if prior.guess is not None:
        tensors |= {f"guess.{name}": value for name, value in prior.guess.state_dict().items()}
        guess = {"guess": asdict(prior.guess.config)}
    _require_floats(tensors, path)
    header = {
        "format": FORMAT,
        "category": prior.category,
        "frame": FRAME,
        "scale": SCALE if prior.box is None else BOX_SCALE,
        "decoder": _decoder_header(prior.decoder),
        **guess,
        "residual_sigma": prior.residual_sigma,
        "size_mean": prior.size_mean,
        "size_log_sigma": prior.size_log_sigma,
        **({} if prior.anisotropy_sigma is None else {"anisotropy_sigma": prior.anisotropy_sigma}),
        "surface_misfit": prior.surface_misfit,
        "sha256": digest(tensors),
        "card": {k: v for k, v in prior.card.items() if k not in _HEADER},
    }
    try:
        read = parse_json(json.dumps(header).encode())
    except (TypeError, ValueError) as error:
        raise PriorError(f"{path} would be no usable shape prior: {error}") from error
    _prior_of({name: value.detach().cpu() for name, value in tensors.items()}, read, path)
    save_tensors(tensors, header, path)


def load_prior_file(path: Path) -> ShapePrior:
    """Read a prior; the card it gets back holds the header's entries too.

    Raises:
        PriorError: the file is missing, truncated, damaged, or no prior; the message names it.
    """
    tensors, header = load_tensors(path)
    if header.get("format") != FORMAT:
        raise PriorError(
            f"{path} is no shape prior of this library (format {header.get('format')!r}, not {FORMAT!r})"
        )
    _require_floats(tensors, path)
    if digest(tensors) != header.get("sha256"):
        raise PriorError(f"{path} is damaged: its tensors do not have the hash that its card gives")
    return _prior_of(tensors, header, path)


def _prior_of(tensors: dict[str, Tensor], header: dict[str, Any], path: Path) -> ShapePrior:
    """The prior of a file's contents; raises PriorError, which names the file, where they are of none."""
    try:
        decoder = _decoder_of(header["decoder"], _part(tensors, "decoder."))
        guess, said = None, header.get("guess")
        if said is not None and "headings" not in said:
            log.warning(
                "%s: its first guess is of an older kind and left out; `objgraph train-guess` makes one", path
            )
        elif said is not None:
            config = typed(FirstGuessConfig, said)
            guess = loaded_network(FirstGuess, config, _part(tensors, "guess.")).requires_grad_(False).eval()
        mean, kinds = tensors["code_mean"].numpy(), _kinds(_part(tensors, "kinds."))
        covariance = tensors["code_covariance"].numpy() if kinds is None else kinds.moments()[1]
        prototypes = tensors["prototypes"].numpy() if "prototypes" in tensors else None
        box = tensors["box"].numpy() if "box" in tensors else None
        known = {name: value.double().numpy() for name, value in _part(tensors, "proportions.").items()}
        proportions = Proportions(**known) if known else None
        numbers = [float(header[key]) for key in ("residual_sigma", "size_mean", "size_log_sigma")]
        anisotropy = float(header["anisotropy_sigma"]) if "anisotropy_sigma" in header else None
        surface_misfit = float(header.get("surface_misfit", 1.0))
        card = {**header["card"], **{key: header[key] for key in _HEADER}}
        category = _category(header["category"])
    except (KeyError, TypeError, ValueError, RuntimeError, FactorError) as error:
        raise PriorError(f"{path} is no usable shape prior: {error}") from error
    length = decoder.code_length
    fit = mean.shape == (length,) and covariance.shape == (length, length)
    if box is not None and (box.shape != (3,) or not (box > 0).all()):
        raise PriorError(f"{path}: the box {box} is not three positive edges")
    if guess is not None and guess.config.code_length != length:
        raise PriorError(f"{path}: its first guess is of codes of another length than its decoder's {length}")
    if proportions is not None and (proportions.slope.shape[1] != length or box is None):
        raise PriorError(
            f"{path}: its proportions are of codes of another length, or of shapes without a box"
        )
    if kinds is not None and kinds.mean.shape[1] != length:
        raise PriorError(f"{path}: its mixture is of codes of another length than its decoder's {length}")
    if not fit or (prototypes is not None and prototypes.shape[1:] != (length,)):
        raise PriorError(
            f"{path}: code statistics of shapes {mean.shape} and {covariance.shape} do not fit a decoder of "
            f"{length}-dimensional codes"
        )
    arrays = [
        mean,
        covariance,
        *([] if prototypes is None else [prototypes]),
        *([] if box is None else [box]),
        numbers,
        [] if anisotropy is None else [anisotropy],
        [surface_misfit],
        *(value.numpy() for value in decoder.state_dict().values()),
        *([] if guess is None else [value.numpy() for value in guess.state_dict().values()]),
    ]
    if not all(np.isfinite(array).all() for array in arrays):
        raise PriorError(f"{path}: a weight or statistic is not finite")
    checks.covariance(f"{path}: the codes' covariance", covariance, length, PriorError)
    positive: list[float] = [*numbers, surface_misfit, *([] if anisotropy is None else [anisotropy])]
    if min(positive) <= 0:
        raise PriorError(f"{path}: a standard deviation, size or factor is not positive: {positive}")
    decoder.requires_grad_(False).eval()
    return ShapePrior(
        category,
        decoder,
        mean,
        covariance,
        *numbers,
        card=card,
        prototypes=prototypes,
        anisotropy_sigma=anisotropy,
        box=box,
        guess=guess,
        surface_misfit=surface_misfit,
        kinds=kinds,
        proportions=proportions,
    )


def _category(said: Any) -> str:
    """A category's name; raises PriorError where, as a folder's, it would lead elsewhere."""
    name = checks.text("the category", said, PriorError)
    if Path(name).is_absolute() or ".." in Path(name).parts:
        raise PriorError(f"the category {name!r} leads out of a folder")
    return name


def _require_floats(tensors: dict[str, Tensor], path: Path) -> None:
    if kinds := {str(value.dtype) for value in tensors.values() if value.dtype not in _FLOATS}:
        raise PriorError(f"{path} holds tensors of {', '.join(sorted(kinds))}, a prior has floats alone")


def _kinds(tensors: dict[str, Tensor]) -> CodeMixture | None:
    if not tensors:
        return None
    weight, mean, log_variance = (
        tensors[name].double().numpy() for name in ("weight", "mean", "log_variance")
    )
    return CodeMixture(weight / weight.sum(), mean, np.exp(log_variance))


def _tensors_of_kinds(kinds: CodeMixture) -> dict[str, Tensor]:
    """In half precision: a part in two thousand of a mean and a hundredth of a variance move no code."""
    return {
        "kinds.weight": torch.from_numpy(kinds.weight).float(),
        "kinds.mean": torch.from_numpy(kinds.mean).half(),
        "kinds.log_variance": torch.from_numpy(np.log(kinds.variance)).half(),
    }


def _part(tensors: dict[str, Tensor], prefix: str) -> dict[str, Tensor]:
    return {key.removeprefix(prefix): value for key, value in tensors.items() if key.startswith(prefix)}


def _decoder_header(decoder: SdfDecoder) -> dict[str, Any]:
    """The decoder's kind and configuration."""
    for kind, (network, _) in _DECODERS.items():
        if isinstance(decoder, network):
            return {"kind": kind, **asdict(decoder.config)}
    raise PriorError(f"a {type(decoder).__name__} cannot be saved; known are {', '.join(_DECODERS)}")


def _decoder_of(header: dict[str, Any], weights: dict[str, Tensor]) -> SdfDecoder:
    """The decoder that a header describes; a header without a kind is of the first."""
    kind, *_ = _DECODERS
    check_fields(header, {"kind": str | None})
    settings = {key: tuple(v) if isinstance(v, list) else v for key, v in header.items() if key != "kind"}
    network, config = _DECODERS[header.get("kind", kind)]
    return loaded_network(network, typed(config, settings), weights)


def digest(tensors: dict[str, Tensor]) -> str:
    """SHA-256 over names, shapes and bytes, in the names' order."""
    sha = hashlib.sha256()
    for name in sorted(tensors):
        value = tensors[name].detach().contiguous().cpu().numpy()
        sha.update(f"{name} {value.dtype} {value.shape}".encode())
        sha.update(value.tobytes())
    return sha.hexdigest()


_DECODERS = {
    "smooth": (Decoder, DecoderConfig),
    "deepsdf": (DeepSdfDecoder, DeepSdfConfig),
    "superquadric": (Superquadric, SuperquadricConfig),
}
_FLOATS = (torch.float16, torch.float32, torch.float64)
_HEADER = ("format", "frame", "scale", "decoder", "sha256")
