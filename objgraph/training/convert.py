"""Priors from elsewhere: a DeepSDF experiment folder becomes a prior of this library."""

import hashlib
import logging
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float

from factors.deepsdf import DeepSdfDecoder
from objgraph.errors import PriorError, SolveError
from objgraph.priors.mesh import extract_mesh
from objgraph.priors.shape_prior import ShapePrior
from objgraph.priors.store import save_prior
from objgraph.training.codes.fit import code_statistics, typical_codes
from objgraph.training.deepsdf_files import Experiment, load_experiment
from objgraph.training.size import size_statistics

log = logging.getLogger(__name__)

_LOOK_IN = 2.0
"""Units of the source in which the shapes are looked for, as one canonical unit: unit spheres fit."""


_WIDER = 9.0
"""Factor on the codes' covariance: a Gaussian through points of several kinds of shapes is dense between them, at shapes of no
kind (a table without legs), and would hold codes there."""


@dataclass(frozen=True)
class ConvertConfig:
    """Make a prior of a DeepSDF experiment folder."""

    source: Path
    """Folder with specs.json, ModelParameters/ and, if there are any, LatentCodes/; frame of ShapeNetCore.v2."""
    category: str
    """Category that the prior is for."""
    out: Path
    """The .safetensors file to write."""
    checkpoint: str = "latest"
    """Which of ModelParameters/*.pth."""
    canonical_scale: float | None = None
    """Bounding-box diagonal of a typical shape in the source's units; measured on decoded shapes by default."""
    code_sigma: float | None = None
    """Standard deviation of the code's entries where there are no LatentCodes; by default specs.json's at the start."""
    residual_sigma: float = 0.01
    """Standard deviation of the SDF error on unseen shapes, in box diagonals: a checkpoint does not say."""
    size: float | None = None
    """Typical bounding-box diagonal of the category, metres; by default what this library knows."""
    size_log_sigma: float | None = None
    """Standard deviation of the logarithm of that diagonal."""


def convert_command(config: ConvertConfig) -> Path:
    """Convert and write, atomically.

    Raises:
        PriorError: the folder cannot be used, or the file is no .safetensors; the message says why.
    """
    if config.out.suffix != ".safetensors":
        raise PriorError(f"--out {config.out} must end in .safetensors")
    try:
        save_prior(convert(config), config.out)
    except OSError as error:
        raise PriorError(f"{config.out} cannot be written: {error}") from error
    return config.out


def convert(config: ConvertConfig) -> ShapePrior:
    """The prior of an experiment folder, its scale folded so that a typical shape's box has diagonal 1.

    Raises:
        PriorError: a file of the folder or a setting cannot be used, or no typical code has a surface.
    """
    for name in ("canonical_scale", "code_sigma", "residual_sigma", "size", "size_log_sigma"):
        value = getattr(config, name)
        if value is not None and not 0 < value < np.inf:
            raise PriorError(f"{name} {value} must be a positive number")
    experiment = load_experiment(config.source, config.checkpoint)
    mean, covariance, prototypes = _code_distribution(experiment, config.code_sigma)
    starts = [mean, *([] if prototypes is None else prototypes)]
    diagonals = _diagonals(experiment, starts)
    unit = config.canonical_scale or float(np.median(diagonals))
    size_mean, size_log_sigma, size_source = size_statistics(config.category, [])
    if config.size is not None:
        size_mean, size_source = config.size, "given"
    # shapes of one canonical scale have boxes of different diagonals: that much less is known of their size
    spread = float(np.std(np.log(diagonals)))
    prior = ShapePrior(
        category=config.category,
        decoder=_in_units(experiment.decoder, unit),
        code_mean=mean,
        code_covariance=covariance,
        residual_sigma=config.residual_sigma,
        size_mean=size_mean,
        size_log_sigma=float(np.hypot(config.size_log_sigma or size_log_sigma, spread)),
        prototypes=prototypes,
    )
    return replace(prior, card=_card(experiment, config, prior, spread, size_source))


def _code_distribution(
    experiment: Experiment, code_sigma: float | None
) -> tuple[Float[np.ndarray, "l"], Float[np.ndarray, "l l"], Float[np.ndarray, "k l"] | None]:
    """Mean, covariance and typical codes: the training's own, widened, or a normal distribution about zero."""
    codes = experiment.codes
    if codes is not None and len(codes) > 1 and np.ptp(codes, axis=0).any():
        mean, covariance = code_statistics(codes)
        return mean, _WIDER * covariance, typical_codes(codes)
    length = experiment.decoder.code_length
    sigma = code_sigma or experiment.code_sigma
    log.warning("%s has no codes beside it: N(0, %.3g) is taken", experiment.model, sigma)
    return np.zeros(length), sigma**2 * np.eye(length), None


def _diagonals(experiment: Experiment, codes: list[Float[np.ndarray, "l"]]) -> Float[np.ndarray, "k"]:
    """Bounding-box diagonals of decoded shapes, in the source's units; codes without a surface are left out."""
    decoder, found, reason = _in_units(experiment.decoder, _LOOK_IN), [], ""
    for code in codes:
        try:
            found.append(_LOOK_IN * float(np.linalg.norm(extract_mesh(decoder, code, resolution=64).extents)))
        except SolveError as error:
            reason = str(error)
    if not found:
        raise PriorError(f"{experiment.model}: none of {len(codes)} typical codes has a surface: {reason}")
    return np.array(found)


def _in_units(decoder: DeepSdfDecoder, unit: float) -> DeepSdfDecoder:
    """The same decoder with `unit` of its units in a canonical one."""
    scaled = DeepSdfDecoder(replace(decoder.config, unit=unit))
    scaled.load_state_dict(decoder.state_dict())
    return scaled.requires_grad_(False).eval()


def _card(
    experiment: Experiment, config: ConvertConfig, prior: ShapePrior, spread: float, size_source: str
) -> dict[str, object]:
    return {
        "data": {
            "training_shapes": None if experiment.codes is None else len(experiment.codes),
            "licences": [],
            "note": "converted: the licence of the weights and of their data is the source's",
        },
        "converted": {
            "folder": config.source.resolve().name,
            "checkpoint": config.checkpoint,
            "epoch": experiment.epoch,
            "description": experiment.description,
            "sha256": hashlib.sha256(experiment.model.read_bytes()).hexdigest(),
            "units_per_diagonal": prior.decoder.config.unit,
            "diagonal_log_sigma": spread,
            "codes": "assumed normal about zero" if prior.prototypes is None else "of the training shapes",
        },
        "residual_source": "given, not measured",
        "size_source": size_source,
    }
