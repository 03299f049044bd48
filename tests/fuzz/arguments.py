"""Calls with arguments that may be wrong, made of right ones."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from hypothesis import strategies as st

from tests.fuzz.strategies import NUMBERS, VALUES, arrays

THINGS = st.sampled_from(
    [
        object(),
        torch.tensor([1.0, 2.0]),
        torch.zeros(3, requires_grad=True),
        np.zeros(0),
        np.full((2, 2), np.nan),
        np.float32(0.5),
        Path("nowhere"),
        b"bytes",
        {1, 2},
        lambda *_: None,
        1j,
    ]
)


def wrong(good: Any) -> st.SearchStrategy[Any]:
    """In place of an argument: one of its kind that may not do, or something else."""
    if isinstance(good, np.ndarray):
        tensors = [good.astype(good.dtype, copy=True)]
        return st.one_of(arrays(good), THINGS, st.sampled_from(tensors).map(torch.as_tensor))
    if isinstance(good, (int, float, np.number)):
        return st.one_of(NUMBERS, NUMBERS, VALUES, THINGS)
    return st.one_of(VALUES, THINGS)


@st.composite
def arguments(draw: st.DrawFn, good: Mapping[str, Any], optional: Mapping[str, Any] | None = None) -> Any:
    """The same keywords, one to three of them (of all, or of the optional ones as well) with something else."""
    given = dict(good) | dict(optional or {})
    names = draw(st.lists(st.sampled_from(sorted(given)), min_size=1, max_size=3, unique=True))
    changed = {name: draw(wrong(given[name])) for name in names}
    return dict(good) | changed


@st.composite
def settings_of(draw: st.DrawFn, kind: Callable[..., Any]) -> dict[str, Any]:
    """Keywords of a dataclass of settings, some of them nonsense."""
    return draw(arguments({}, vars(kind())))
