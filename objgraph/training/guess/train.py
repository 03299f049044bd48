"""Train a first guess on rendered views, and measure one on shapes that it was not trained on."""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Bool, Float
from numpy.random import Generator
from torch import Tensor

from factors import checks
from objgraph.errors import ConfigError, PriorError
from objgraph.priors.first_guess import PLACE, FirstGuess, FirstGuessConfig, gaussian
from objgraph.priors.tensors import load_tensors, save_tensors
from objgraph.training.guess.data import TURNS, Batch, Draws, batch, first_views, varied

_AT_ONCE = 8
"""Objects that are looked at together: what sixteen clouds of each take stays in the processor's cache."""


@dataclass(frozen=True)
class TrainGuessConfig:
    """How a first guess is trained."""

    network: FirstGuessConfig = field(
        default_factory=lambda: FirstGuessConfig(normals=True, temperature=30.0)
    )
    """Its size; the length of codes is the decoder's."""
    scenes: int = 7000
    """Rendered scenes that it learns from, evenly of all training shapes."""
    steps: int = 8000
    """Optimiser steps; without any the prior has no first guess."""
    batch: int = 32
    """Objects a step."""
    learning_rate: float = 1e-3
    """Of Adam; it falls to nothing along a cosine."""
    code_weight: float = 0.1
    """Of a code's log-likelihood beside that of place and heading: it has many numbers, of which most say little."""
    half_precision: bool = True
    """Whether layers are multiplied in bfloat16."""
    seed: int = 0
    """Of weights, scenes and batches."""
    checkpoint_every: int = 500
    """Steps between checkpoints."""

    def __post_init__(self) -> None:
        """Raises ConfigError where a number is not one of its kind."""
        some = checks.Range(1)
        checks.settings(
            self, ConfigError, scenes=some, batch=some, learning_rate=checks.POSITIVE, checkpoint_every=some
        )


def loss(
    network: FirstGuess, wanted: Batch, codes: Float[Tensor, "b l"], code_weight: float, rng: Generator
) -> Float[Tensor, ""]:
    """Negative log-likelihood of headings, and of place and code at one that is right."""
    logits = network.heading(wanted.points, wanted.size)[..., 0]
    heading = -(wanted.weight * logits.log_softmax(dim=1)).sum(dim=1).mean()
    each = torch.arange(len(codes))
    chances = wanted.weight.double().cumsum(dim=1).numpy()
    at = torch.from_numpy((rng.random((len(codes), 1)) > chances / chances[:, -1:]).sum(axis=1))
    mean, log_sigma = gaussian(network.place(wanted.points[each, at], wanted.size[each, at]))
    off = (torch.cat([wanted.place[each, at], codes], dim=-1) - mean) * torch.exp(-log_sigma)
    nll = 0.5 * off.square() + log_sigma
    weights = torch.ones(nll.shape[1])
    weights[PLACE:] = code_weight
    return heading + (nll @ weights).mean()


def train_guess(
    draws: Draws,
    codes: Float[np.ndarray, "s l"],
    unit: float,
    config: TrainGuessConfig,
    checkpoint: Path | None = None,
    progress: Callable[[int, int, float], None] | None = None,
    stop_after: int | None = None,
) -> FirstGuess:
    """Train on draws of shapes with these codes; goes on from the checkpoint where there is one.

    Raises:
        PriorError: the checkpoint is not of this configuration.
    """
    with torch.random.fork_rng(devices=[]):  # the caller's generator stays as it was
        torch.manual_seed(config.seed)
        network = FirstGuess(config.network)
    optimizer = torch.optim.Adam(network.parameters(), lr=config.learning_rate, fused=True)
    average = {name: value.clone() for name, value in network.state_dict().items()}
    first = _resume(checkpoint, config, network, optimizer, average)
    mean_loss = 0.0
    for step in range(first, config.steps if stop_after is None else min(config.steps, stop_after)):
        rng = np.random.default_rng([config.seed, step])
        optimizer.param_groups[0]["lr"] = (
            config.learning_rate
            * min(1.0, (step + 1) / 200)
            * 0.5
            * (1 + np.cos(np.pi * step / config.steps))
        )
        rows = rng.integers(len(draws), size=config.batch)
        optimizer.zero_grad(set_to_none=True)
        value = 0.0
        for some in np.array_split(rows, max(1, len(rows) // _AT_ONCE)):
            wanted = batch(draws, some.tolist(), unit, config.network, rng, varied(rng))
            given = torch.from_numpy(codes[wanted.shape]).float()
            with torch.autocast("cpu", dtype=torch.bfloat16, enabled=config.half_precision):
                share = loss(network, wanted, given, config.code_weight, rng) * (len(some) / len(rows))
            share.backward()
            value += share.item()
        for part in (network.heading, network.place):
            torch.nn.utils.clip_grad_norm_(part.parameters(), 10.0)
        optimizer.step()
        decay = min(0.998, (step + 1) / (step + 10))
        for name, tensor in network.state_dict().items():
            average[name].lerp_(tensor, 1 - decay)
        mean_loss += (value - mean_loss) / min(step - first + 1, 200)
        if progress is not None:
            progress(step + 1, config.steps, mean_loss)
        if checkpoint is not None and (step + 1) % config.checkpoint_every == 0:
            _save(checkpoint, config, step + 1, network, optimizer, average)
    network.load_state_dict(average)
    return network.requires_grad_(False).eval()


@dataclass(frozen=True)
class GuessQuality:
    """On objects that the network did not see."""

    heading_right: float
    """Share whose likeliest heading is within 20 degrees of the true one, or where the object looks the same."""
    heading_nll: float
    """Mean negative log-probability of what is right, nats."""
    centre_m: float
    """Median distance of the likeliest heading's centre from the true one, metres."""
    log_scale: float
    """Median, over objects, of the root mean square error of the scale's logarithm."""
    right: Bool[np.ndarray, "n"]
    """Whether each object's likeliest heading is."""
    probability: Float[np.ndarray, "n h"]
    """Of each object's headings."""
    wanted: Float[np.ndarray, "n h"]
    """What they should be: one, or shared by those that look the same."""

    def as_json(self) -> dict[str, float | int]:
        """All but the single objects."""
        return {
            "objects": len(self.right), "heading_right": self.heading_right, "heading_nll": self.heading_nll,
            "centre_m": self.centre_m, "log_scale": self.log_scale,
        }  # fmt: skip


@torch.no_grad()
def measure_guess(
    network: FirstGuess, draws: Draws, unit: float, views: int, seed: int = 0, limit_deg: float = 20.0
) -> GuessQuality:
    """Of objects with that many views.

    Raises:
        PriorError: there are none.
    """
    rng = np.random.default_rng(seed)
    rows = [i for i in range(len(draws)) if draws.views[i] >= views]
    if not rows:
        raise PriorError(f"no object is seen in {views} views: measure the first guess with fewer")
    some = [rows[k : k + _AT_ONCE] for k in range(0, len(rows), _AT_ONCE)]
    seen = [
        _judged(network, batch(draws, part, unit, network.config, rng, first_views(views)), limit_deg)
        for part in some
    ]
    right, mass, centre, log_scale, probability, wanted = map(np.concatenate, zip(*seen, strict=True))
    return GuessQuality(
        float(right.mean()),
        float(-np.log(mass.clip(1e-6)).mean()),
        float(np.median(centre)) * unit,
        float(np.median(log_scale)),
        right,
        probability,
        wanted,
    )


def _judged(network: FirstGuess, wanted: Batch, limit_deg: float) -> tuple[np.ndarray, ...]:
    """Of each object: whether the likeliest heading is right, the probability of all that are, how far the centre and the scale are
    off, all probabilities and what they should be."""
    guesses = network(wanted.points, wanted.size)
    # of each heading, once what is left of it is added: how far it is from the object's, and whether that can be seen
    away = guesses.mean[..., 0] - wanted.off
    away = torch.remainder(away + torch.pi, 2 * torch.pi) - torch.pi
    turn = (away * TURNS / (2 * torch.pi)).round().long() % TURNS
    right = (away.abs() < np.radians(limit_deg)) | wanted.alike.gather(1, turn)
    best = guesses.log_probability.argmax(dim=1)
    each = torch.arange(len(best))
    off = (guesses.mean[..., :PLACE] - wanted.place)[each, best]
    probability = guesses.log_probability.exp()
    judged = (
        right[each, best], torch.where(right, probability, 0.0).sum(dim=1), off[:, 1:4].norm(dim=1),
        off[:, 4:7].square().mean(dim=1).sqrt(), probability, wanted.weight,
    )  # fmt: skip
    return tuple(each.numpy() for each in judged)


def _save(path, config, step, network, optimizer, average) -> None:
    tensors = {f"weight/{k}": v for k, v in network.state_dict().items()}
    tensors |= {f"average/{k}": v for k, v in average.items()}
    for i, state in optimizer.state_dict()["state"].items():
        tensors |= {f"adam/{i}/{key}": value for key, value in state.items()}
    save_tensors(tensors, {"step": step, "config": repr(config)}, path)


def _resume(path, config, network, optimizer, average) -> int:
    if path is None or not path.is_file():
        return 0
    tensors, header = load_tensors(path)
    if header.get("config") != repr(config):
        raise PriorError(f"{path} is of another training of a first guess; remove it or give another file")
    network.load_state_dict(
        {k.removeprefix("weight/"): v for k, v in tensors.items() if k.startswith("weight/")}
    )
    average.update({k.removeprefix("average/"): v for k, v in tensors.items() if k.startswith("average/")})
    state = optimizer.state_dict()
    for key, value in tensors.items():
        if key.startswith("adam/"):
            _, i, name = key.split("/")
            state["state"].setdefault(int(i), {})[name] = value
    optimizer.load_state_dict(state)
    return int(header["step"])
