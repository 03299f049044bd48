"""Row by row it is torch's Adam; rows of no batch stay; a state put back goes on as before."""

import torch
from hypothesis import given
from hypothesis import strategies as st

from objgraph.training.decoder.row_adam import RowAdam


@given(st.lists(st.sets(st.integers(0, 4), min_size=1), min_size=1, max_size=8), st.integers(0, 10))
def test_every_row_moves_as_by_an_adam_of_its_own(batches: list[set[int]], seed: int) -> None:
    generator = torch.Generator().manual_seed(seed)
    start = torch.randn(5, 3, generator=generator).double()
    tables = RowAdam({"a": start.clone(), "b": 2 * start})
    alone = [torch.nn.Parameter(start[i].clone()) for i in range(5)]
    optimizers = [torch.optim.Adam([row], lr=0.1) for row in alone]
    for k, batch in enumerate(batches):
        if k == len(batches) // 2:
            before = {name: value.clone() for name, value in tables.state().items()}
            tables = RowAdam({"a": start.clone(), "b": 2 * start})
            tables.restore(before)
        index = torch.tensor(sorted(batch))
        rows = tables.rows(index)
        (rows["a"].sin().sum() + rows["b"].square().sum()).backward()
        tables.step(index, rows, 0.1)
        for i in batch:
            optimizers[i].zero_grad()
            alone[i].sin().sum().backward()
            optimizers[i].step()
    torch.testing.assert_close(tables.tables["a"], torch.stack([row.detach() for row in alone]))
