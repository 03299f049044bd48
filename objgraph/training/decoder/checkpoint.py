"""The state of a training: decoder, codes, their running average and the optimiser, as tensors by name."""

import math
from pathlib import Path

import torch
from torch import Tensor

from factors.decoder import Decoder
from objgraph.errors import PriorError
from objgraph.training.decoder.kinds import Kinds
from objgraph.training.decoder.row_adam import RowAdam


class AutoDecoder:
    """A decoder with a running average of its weights, a Gaussian over the code of every training shape, the mixture that
    these are held to, and the last error of each of their samples."""

    def __init__(
        self,
        decoder: Decoder,
        samples: tuple[int, int],
        code_length: int,
        kinds: int,
        seed: int,
        decay: float,
        sigma: float,
    ) -> None:
        self.decoder = decoder
        shapes = samples[0]
        device, generator = next(decoder.parameters()).device, torch.Generator().manual_seed(seed)
        mean = 0.1 * torch.randn(shapes, code_length, generator=generator)
        log_variance = torch.full((shapes, code_length), 2 * math.log(sigma))
        self.codes = RowAdam({"mean": mean.to(device), "log_variance": log_variance.to(device)})
        self.kinds = Kinds(kinds, self.codes.tables["mean"], seed)
        # nothing is as bad as what was never looked at
        self.errors = torch.full(samples, torch.finfo(torch.float16).max, dtype=torch.float16, device=device)
        self.average = {name: value.detach().clone() for name, value in decoder.named_parameters()}
        self.decay = decay

    @torch.no_grad()
    def update_average(self, step: int) -> None:
        """Move the average towards the present weights; quickly at first."""
        decay = min(self.decay, (step + 1) / (step + 10))
        for name, value in self.decoder.named_parameters():
            self.average[name] = self.average[name].to(value).lerp_(value, 1 - decay)


def pack(model: AutoDecoder, optimizer: torch.optim.Optimizer) -> dict[str, Tensor]:
    """Everything that a resumed training needs, as named tensors."""
    tensors = {f"weight/{name}": value for name, value in model.decoder.named_parameters()}
    tensors |= {f"average/{name}": value for name, value in model.average.items()}
    tensors["errors"] = model.errors
    tensors |= {f"codes/{name}": value for name, value in model.codes.state().items()}
    tensors |= {f"kinds/{name}": value for name, value in model.kinds.state().items()}
    for i, state in optimizer.state_dict()["state"].items():
        tensors |= {f"adam/{i}/{key}": value for key, value in state.items()}
    return tensors


@torch.no_grad()
def unpack(
    tensors: dict[str, Tensor], model: AutoDecoder, optimizer: torch.optim.Optimizer, path: Path
) -> None:
    """Put a packed state back.

    Raises:
        PriorError: the tensors are of another network or another set of shapes.
    """
    try:
        for name, value in model.decoder.named_parameters():
            value.copy_(tensors[f"weight/{name}"])
            model.average[name].copy_(tensors[f"average/{name}"])
        model.errors.copy_(tensors["errors"])
        model.codes.restore(_part(tensors, "codes/"))
        model.kinds.restore(_part(tensors, "kinds/"))
        state: dict[int, dict[str, Tensor]] = {}
        for name, tensor in tensors.items():
            if name.startswith("adam/"):
                _, i, key = name.split("/")
                state.setdefault(int(i), {})[key] = tensor
        optimizer.load_state_dict({"state": state, "param_groups": optimizer.state_dict()["param_groups"]})
    except (KeyError, RuntimeError, ValueError) as error:
        raise PriorError(
            f"{path} is the checkpoint of another training: give an empty folder ({error})"
        ) from error


def _part(tensors: dict[str, Tensor], prefix: str) -> dict[str, Tensor]:
    return {name.removeprefix(prefix): value for name, value in tensors.items() if name.startswith(prefix)}
