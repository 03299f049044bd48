"""One decoder call for many factors: they may belong to many objects, views and kinds."""

from collections.abc import Iterable, Iterator, Sequence

import gtsam
import torch
from jaxtyping import Float, Int
from torch import Tensor

from factors.base import ObservationFactor
from factors.sdf import SdfQuery
from factors.sdf_decoder import SdfJet

CHUNK = 65536
"""Points a decoder call: bounds the memory of a large map."""


def prefetch(factors: Iterable[ObservationFactor], values: gtsam.Values, jacobian: bool) -> None:
    """Decode what `factors` need at `values` in few calls; their next evaluation there is free of decoding."""
    decode([(factor, factor.query(values)) for factor in factors], jacobian)


def decode(queries: Sequence[tuple[ObservationFactor, SdfQuery]], jacobian: bool) -> None:
    """The same for what factors ask, each at values of its own."""
    for batch in _batches([item for item in queries if item[0].known_value(item[1]) is None]):
        points, codes, owner, sizes = _stack(batch)
        with torch.no_grad():
            found = batch[0][0].decoder(points, codes, owner).cpu().split(sizes)
        for (factor, query), value in zip(batch, found, strict=True):
            factor.remember(query, value)
    if jacobian:
        _prefetch_jets([item for item in queries if item[0].known_jet(item[1]) is None])


def _prefetch_jets(queries: list[tuple[ObservationFactor, SdfQuery]]) -> None:
    some, whole = [], {}
    for factor, query in queries:
        value = factor.known_value(query)
        if value is None:  # not finite: the factor's own evaluation says so
            continue
        some.append((factor, query.take(factor.active(query, value))))
        whole[id(factor)] = query, value
    for batch in _batches(some):
        points, codes, owner, sizes = _stack(batch)
        jet = batch[0][0].decoder.linearize(points, codes, owner).cpu()
        for (factor, _), *parts in zip(batch, *(part.split(sizes) for part in jet), strict=True):
            factor.remember(*whole[id(factor)], SdfJet(*parts))


def _batches(
    queries: list[tuple[ObservationFactor, SdfQuery]],
) -> Iterator[list[tuple[ObservationFactor, SdfQuery]]]:
    """Groups of one decoder and bounded size."""
    by_decoder: dict[int, list[tuple[ObservationFactor, SdfQuery]]] = {}
    for factor, query in queries:
        by_decoder.setdefault(id(factor.decoder), []).append((factor, query))
    for group in by_decoder.values():
        batch, size = [], 0
        for item in group:
            if batch and size + len(item[1].p_object) > CHUNK:
                yield batch
                batch, size = [], 0
            batch.append(item)
            size += len(item[1].p_object)
        yield batch


def _stack(
    batch: list[tuple[ObservationFactor, SdfQuery]],
) -> tuple[Float[Tensor, "n 3"], Float[Tensor, "b l"], Int[Tensor, "n"], list[int]]:
    sizes = [len(query.p_object) for _, query in batch]
    points = torch.cat([query.p_object for _, query in batch])
    codes, owners = [], []
    for _, query in batch:  # factors of one object follow each other
        if not codes or not torch.equal(codes[-1], query.code):
            codes.append(query.code)
        owners.append(len(codes) - 1)
    owner = torch.repeat_interleave(torch.tensor(owners), torch.tensor(sizes)).to(points.device)
    return points, torch.stack(codes), owner, sizes
