"""One decoder call for many shapes, each asked about points of its own."""

from collections.abc import Sequence
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from factors.sdf_decoder import SdfDecoder, SdfJet


class Asked(NamedTuple):
    """Canonical points of one shape."""

    decoder: SdfDecoder
    code: Float[Tensor, "l"]
    p_object: Float[Tensor, "n 3"]


def decode(asked: Sequence[Asked]) -> list[SdfJet]:
    """Distances and derivatives for each of `asked`, in one call a decoder."""
    jets: dict[int, SdfJet] = {}
    by_decoder: dict[int, list[int]] = {}
    for i, item in enumerate(asked):
        by_decoder.setdefault(id(item.decoder), []).append(i)
    for indices in by_decoder.values():
        group = [asked[i] for i in indices]
        sizes = [len(item.p_object) for item in group]
        points = torch.cat([item.p_object for item in group])
        owner = torch.repeat_interleave(torch.arange(len(group)), torch.tensor(sizes)).to(points.device)
        jet = group[0].decoder.linearize(points, torch.stack([item.code for item in group]), owner)
        parts = zip(*(part.split(sizes) for part in jet), strict=True)
        jets.update({i: SdfJet(*part) for i, part in zip(indices, parts, strict=True)})
    return [jets[i] for i in range(len(asked))]
