"""Training of a shape prior: a variational auto-decoder over signed-distance samples.

Park et al., "DeepSDF", 2019; every shape's code is a Gaussian of which each step draws one (Zadeh et al., "Variational
Auto-Decoder", 2019), held to a mixture that is fitted to them all: so codes drawn from the mixture are shapes as well.
"""

import hashlib
import json
import logging
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from factors import checks
from factors.code_mixture import CodeMixture
from factors.decoder import Decoder, DecoderConfig
from objgraph.errors import ConfigError, PriorError
from objgraph.priors.tensors import load_tensors, save_tensors
from objgraph.training.decoder.box_frame import BoxFrame
from objgraph.training.decoder.checkpoint import AutoDecoder, pack, unpack
from objgraph.training.decoder.losses import LossConfig, sample_errors
from objgraph.training.guess.train import TrainGuessConfig
from objgraph.training.meshes.corpus import Corpus, CorpusConfig
from objgraph.training.meshes.samples import SampleConfig, SdfSamples
from objgraph.work import threads

log = logging.getLogger(__name__)

_REFIT = 100
"""Steps between fits of the mixture."""

_SOME = checks.Range(1)


@dataclass(frozen=True)
class OptimiserConfig:
    """Batches and rates of a training."""

    shapes_per_step: int = 128
    """Shapes in a batch."""
    points_per_shape: int = 48
    """Samples of each of them."""
    candidates: int = 3
    """Samples of which the one that was worst when last looked at is taken (as in Shrivastava et al., "Training
    region-based object detectors with online hard example mining", 2016): thin parts have few."""
    learning_rate: float = 1e-3
    """Adam's step for the network."""
    code_learning_rate: float = 4e-2
    """Adam's step for the codes of the batch, which see fewer steps than the network does."""
    warmup: int = 200
    """Steps over which the learning rate rises from zero."""
    cooldown: float = 0.45
    """Last share of the steps, over which it falls to zero."""
    code_sigma: float = 0.1
    """First standard deviation of the codes."""
    average_decay: float = 0.999
    """Decay a step of the running average of the weights that is exported."""

    def __post_init__(self) -> None:
        """Raises ConfigError where a number is not one of its kind."""
        checks.settings(
            self,
            ConfigError,
            shapes_per_step=_SOME,
            points_per_shape=_SOME,
            candidates=_SOME,
            learning_rate=checks.POSITIVE,
            code_learning_rate=checks.POSITIVE,
            cooldown=checks.SHARES,
            code_sigma=checks.POSITIVE,
            average_decay=checks.SHARES,
        )


@dataclass(frozen=True)
class TrainConfig:
    """A training of one category's shape prior."""

    category: str = "chair"
    """The category to train."""
    meshes: tuple[Path, ...] = ()
    """Folders of meshes (y up, front at -z; any size), with or without an `index.json` that lists them; left out, only
    the procedural families are used."""
    out: Path = Path("out/train")
    """Work folder: sample cache, checkpoint, and the trained prior."""
    decoder: DecoderConfig = field(
        default_factory=lambda: DecoderConfig(width=128, octaves=2, activation="relu", mapping=256)
    )
    """The network."""
    corpus: CorpusConfig = field(default_factory=CorpusConfig)
    """The shapes."""
    samples: SampleConfig = field(default_factory=SampleConfig)
    """Where their distances are sampled."""
    optimiser: OptimiserConfig = field(default_factory=OptimiserConfig)
    """How the decoder's weights and the codes are found."""
    loss: LossConfig = field(default_factory=LossConfig)
    """What is asked of them."""
    guess: TrainGuessConfig = field(default_factory=TrainGuessConfig)
    """The network that says of what is seen how an object may stand, trained when the decoder is."""
    normalisation: Literal["box", "diagonal"] = "box"
    """The decoder's frame: every shape stretched to the category's typical box, so that the object's scales carry
    its extents alone, or the shape's own box of diagonal 1."""
    stands: bool = True
    """Whether such objects stand on the floor: those that hang or lie on others do not."""
    steps: int = 40_000
    """Optimiser steps; may be raised or lowered between resumed runs."""
    code_weight: float = 2e-5
    """Weight of the divergence, in nats, of a code's Gaussian from the mixture; it rises over the first tenth of the
    steps, in which that is N(0, I)."""
    kinds: int = 400
    """Kinds of shapes, each a Gaussian of the mixture beside that of all codes; at most one in eight shapes, and 1 leaves N(0, I)."""
    seed: int = 0
    """Seed of weights, codes and batches."""
    threads: int = 1
    """CPU threads of the training."""
    jobs: int = 1
    """Processes that sample the shapes."""
    device: str = "cpu"
    """Torch device: cpu, cuda, cuda:1; a training may go on on another one, with results equal to rounding."""
    bf16: float = 0.0
    """Share of the steps, from the first, in which the network computes in bfloat16: several times as fast on GPUs and CPUs
    that have it, and slow on others."""
    checkpoint_seconds: float = 60.0
    """Time between checkpoints."""

    def __post_init__(self) -> None:
        """Raises ConfigError where a number is not one of its kind."""
        checks.settings(
            self, ConfigError, steps=_SOME, kinds=_SOME, threads=_SOME, jobs=_SOME, bf16=checks.SHARES
        )

    def fingerprint(self) -> str:
        """A hash of what must not change between resumed runs."""
        fixed = {
            key: value
            for key, value in asdict(self).items()
            if key
            not in {
                "meshes",
                "out",
                "stands",
                "steps",
                "threads",
                "jobs",
                "device",
                "bf16",
                "checkpoint_seconds",
                "guess",
            }
        }
        fixed["optimiser"].pop("cooldown")
        return hashlib.sha256(json.dumps(fixed, sort_keys=True, default=str).encode()).hexdigest()[:16]


@dataclass(frozen=True)
class Trained:
    """What a training hands over, at whatever step it stopped."""

    decoder: Decoder
    codes: Float[np.ndarray, "s l"]
    """Means of the training shapes' Gaussians."""
    code_mean: Float[np.ndarray, "l"]
    code_covariance: Float[np.ndarray, "l l"]
    """Of all codes that these Gaussians give."""
    kinds: CodeMixture | None
    """The mixture that they were held to; None where it was one Gaussian."""
    box: BoxFrame | None
    """The frame that the shapes were stretched to."""
    step: int
    loss: float


Progress = Callable[[int, float], None]
"""Called after a step with the number of steps done and a running mean of the loss."""


def checkpoint_path(config: TrainConfig) -> Path:
    """Where a training keeps its state."""
    return config.out / f"{config.category}.checkpoint"


def train(config: TrainConfig, corpus: Corpus, progress: Progress | None = None) -> Trained:
    """Train, or resume, until `config.steps`; a killed run resumes at its checkpoint with the same result.

    Raises:
        PriorError: no shape to train on, a loss that is not finite, or a checkpoint of another training.
    """
    if not corpus.training:
        raise PriorError(
            f"there is no {config.category} to train on: every mesh was left out or held out; give more, or "
            f"--corpus.heldout-share 0 to hold out none"
        )
    with threads(config.threads):
        return _train(config, corpus, progress)


def _train(config: TrainConfig, corpus: Corpus, progress: Progress | None) -> Trained:
    points, sdf = (tensor.to(_device(config)) for tensor in _stack(corpus.training, _box(config, corpus)))
    model, optimizer = _model(config, *sdf.shape)
    path, shapes = checkpoint_path(config), _digest(corpus.training)
    step, mean = _resume(config, shapes, path, model, optimizer)
    saved = time.monotonic()
    while step < config.steps:
        rate, risen = schedule(config, step), 10 * step / config.steps
        if risen >= 1 and step % _REFIT == 0:
            model.kinds.fit(**model.codes.tables)
        optimizer.param_groups[0]["lr"] = config.optimiser.learning_rate * rate
        batch, pick = _batch(config, step, model.errors)
        batch_points, batch_sdf = points[pick], sdf[pick]
        optimizer.zero_grad(set_to_none=True)
        rows = model.codes.rows(batch)
        noise = torch.randn(rows["mean"].shape, generator=torch.Generator().manual_seed(step)).to(sdf)
        codes = rows["mean"] + (0.5 * rows["log_variance"]).exp() * noise
        with torch.autocast(points.device.type, torch.bfloat16, enabled=step < config.bf16 * config.steps):
            prediction = model.decoder.in_blocks(batch_points, codes).float()
        errors = sample_errors(prediction, batch_sdf, config.loss)
        model.errors[pick] = errors.detach().to(model.errors)
        loss = errors.mean()
        held = model.kinds.divergence(**rows).mean()
        (loss + min(1.0, risen) * config.code_weight * held).backward()
        value = loss.item()
        if not np.isfinite(value):
            raise PriorError(
                f"training {config.category}: the loss is {value} at step {step}; lower the learning rate or "
                f"look at the samples (the last good checkpoint is {path})"
            )
        optimizer.step()
        model.codes.step(batch, rows, config.optimiser.code_learning_rate * rate)
        model.update_average(step)
        mean = value if step == 0 else mean + (value - mean) / min(step + 1, 500)
        step += 1
        if time.monotonic() - saved > config.checkpoint_seconds or step == config.steps:
            _save(config, shapes, path, model, optimizer, step, mean)
            saved = time.monotonic()
        if progress is not None:
            progress(step, mean)
    return _trained(config, corpus, model, step, mean)


def schedule(config: TrainConfig, step: int) -> float:
    """Share of the learning rates at a step: linear rise, plateau, linear fall to a fiftieth."""
    rise = min(1.0, (step + 1) / max(config.optimiser.warmup, 1))
    left = (config.steps - step) / max(config.optimiser.cooldown * config.steps, 1.0)
    return rise * min(1.0, max(left, 0.02))


def _box(config: TrainConfig, corpus: Corpus) -> BoxFrame | None:
    if config.normalisation == "diagonal":
        return None
    return BoxFrame.of(np.stack([shape.extents for shape in corpus.training]))


def _stack(
    shapes: tuple[SdfSamples, ...], box: BoxFrame | None
) -> tuple[Float[Tensor, "s n 3"], Float[Tensor, "s n"]]:
    points = np.stack([shape.points for shape in shapes])
    if box is not None:
        points /= np.stack([box.stretch(shape.extents) for shape in shapes]).astype(np.float32)[:, None]
    sdf = np.stack([shape.sdf for shape in shapes])
    return torch.from_numpy(points), torch.from_numpy(sdf)


def _batch(
    config: TrainConfig, step: int, errors: Float[Tensor, "s n"]
) -> tuple[Int[Tensor, "b"], tuple[Int[Tensor, "b 1"], Int[Tensor, "b k"]]]:
    """The shapes and samples of a step, which its number, the seed and the last errors decide alone."""
    rng = np.random.default_rng([config.seed, step])
    count = min(config.optimiser.shapes_per_step, len(errors))
    batch = torch.from_numpy(rng.choice(len(errors), count, replace=False)).to(errors.device)
    size = (count, config.optimiser.points_per_shape, config.optimiser.candidates)
    rows = torch.from_numpy(rng.integers(errors.shape[1], size=size)).to(errors.device)
    worst = errors[batch[:, None, None], rows].argmax(dim=2, keepdim=True)
    return batch, (batch[:, None], rows.gather(2, worst).squeeze(2))


def _model(config: TrainConfig, shapes: int, samples: int) -> tuple[AutoDecoder, torch.optim.Optimizer]:
    decoder = _decoder(config).to(_device(config))
    model = AutoDecoder(
        decoder,
        (shapes, samples),
        config.decoder.code_length,
        max(1, min(config.kinds, shapes // 8)),
        config.seed,
        config.optimiser.average_decay,
        config.optimiser.code_sigma,
    )
    return model, torch.optim.Adam(decoder.parameters())


def _device(config: TrainConfig) -> torch.device:
    try:
        return torch.empty(0, device=config.device).device
    except (RuntimeError, AssertionError) as error:
        raise PriorError(f"device {config.device!r} cannot be used, try cpu: {error}") from error


def _decoder(config: TrainConfig) -> Decoder:
    """A decoder with the seed's own first weights; the caller's generator is left as it was."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(config.seed)
        return Decoder(config.decoder)


def _digest(shapes: tuple[SdfSamples, ...]) -> str:
    """A hash of the shapes' names and samples, in their order."""
    sha = hashlib.sha256()
    for shape in shapes:
        sha.update(shape.name.encode())
        for array in (shape.points, shape.sdf, shape.extents):
            sha.update(np.ascontiguousarray(array).tobytes())
    return sha.hexdigest()[:16]


def _resume(
    config: TrainConfig, shapes: str, path: Path, model: AutoDecoder, optimizer: torch.optim.Optimizer
) -> tuple[int, float]:
    if not path.is_file():
        return 0, 0.0
    tensors, state = load_tensors(path)
    if state.get("fingerprint") != config.fingerprint() or state.get("shapes") != shapes:
        raise PriorError(
            f"{path} is the checkpoint of another training (other settings or shapes): give an empty folder"
        )
    unpack(tensors, model, optimizer, path)
    log.info("%s: resumed at step %d", path, state["step"])
    return state["step"], state["loss"]


def _save(
    config: TrainConfig,
    shapes: str,
    path: Path,
    model: AutoDecoder,
    optimizer: torch.optim.Optimizer,
    step: int,
    loss: float,
) -> None:
    state = {
        "fingerprint": config.fingerprint(),
        "shapes": shapes,
        "step": step,
        "loss": loss,
    }
    save_tensors(pack(model, optimizer), state, path)


def _trained(config: TrainConfig, corpus: Corpus, model: AutoDecoder, step: int, loss: float) -> Trained:
    decoder = _decoder(config)
    decoder.load_state_dict({name: value.cpu() for name, value in model.average.items()})
    decoder.requires_grad_(False).eval()
    codes = model.codes.tables["mean"].cpu().numpy().copy()
    moments = model.kinds.moments(**model.codes.tables)
    return Trained(decoder, codes, *moments, model.kinds.mixture(), _box(config, corpus), step, loss)
