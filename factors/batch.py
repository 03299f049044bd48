"""One decoder call for many factors: they may belong to many objects, views and kinds."""

from collections.abc import Iterable

import gtsam
import torch

from factors.base import ObservationFactor
from factors.decoder import SdfJet
from factors.sdf import SdfQuery

CHUNK = 65536
"""Points a decoder call: bounds the memory of a large map."""


def prefetch(factors: Iterable[ObservationFactor], values: gtsam.Values, jacobian: bool) -> None:
    """Decode what `factors` need at `values` in few calls; their next evaluation there is free of decoding."""
    by_decoder: dict[int, list[tuple[ObservationFactor, SdfQuery]]] = {}
    for factor in factors:
        query = factor.query(values)
        if not factor.knows(query, jacobian):
            by_decoder.setdefault(id(factor.decoder), []).append((factor, query))
    for group in by_decoder.values():
        for batch in _chunks(group):
            _decode(batch, jacobian)


def _chunks(group: list[tuple[ObservationFactor, SdfQuery]]):
    batch, size = [], 0
    for item in group:
        if batch and size + len(item[1].p_object) > CHUNK:
            yield batch
            batch, size = [], 0
        batch.append(item)
        size += len(item[1].p_object)
    if batch:
        yield batch


def _decode(batch: list[tuple[ObservationFactor, SdfQuery]], jacobian: bool) -> None:
    decoder = batch[0][0].decoder
    sizes = [len(query.p_object) for _, query in batch]
    points = torch.cat([query.p_object for _, query in batch])
    codes = torch.stack([query.code for _, query in batch])
    owner = torch.repeat_interleave(torch.arange(len(batch)), torch.tensor(sizes)).to(points.device)
    if jacobian:
        jets = zip(*(part.split(sizes) for part in decoder.linearize(points, codes, owner)), strict=True)
        for (factor, query), parts in zip(batch, jets, strict=True):
            jet = SdfJet(*parts)
            factor.remember(query, jet.value, jet)
        return
    with torch.no_grad():
        values = decoder(points, codes, owner).split(sizes)
    for (factor, query), value in zip(batch, values, strict=True):
        factor.remember(query, value, None)
