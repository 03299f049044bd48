"""A figure of the program's speed, and how it is measured: in turns, so that whatever else the machine does hits all alike."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np


@dataclass(frozen=True)
class Figure:
    """One of what `objgraph bench` reports."""

    name: str
    value: float
    """Of ratios that of the medians."""
    low: float
    """The least of the repeats, or where there is but one the value itself."""
    high: float
    aim: float | None
    """What it should be, at most or at least."""
    better: Literal["less", "more"]
    what: str
    """What was measured, in words, with its size and seed."""

    @property
    def reached(self) -> bool | None:
        """Whether it is as it should be; None where nothing was aimed at."""
        if self.aim is None:
            return None
        return self.value <= self.aim if self.better == "less" else self.value >= self.aim


def ratio(
    name: str,
    above: list[float],
    below: list[float],
    aim: float | None,
    what: str,
    better: Literal["less", "more"] = "less",
) -> Figure:
    """Of the medians; low and high are of the pairs."""
    pairs = np.array(above) / np.array(below)
    value = float(np.median(above) / np.median(below))
    return Figure(name, value, float(pairs.min()), float(pairs.max()), aim, better, what)


def in_turns(calls: dict[str, Callable[[], object]], repeats: int) -> dict[str, list[float]]:
    """Processor seconds of each call, one after the other, again and again; a first round does not count."""
    spent: dict[str, list[float]] = {name: [] for name in calls}
    for k in range(repeats + 1):
        for name, call in calls.items():
            begun = time.process_time()
            call()
            if k:
                spent[name].append(time.process_time() - begun)
    return spent
