"""A round about toy chairs that has no end, and what a process holds on the way."""

import gc
import json
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import gtsam
import numpy as np
from matplotlib.figure import Figure

from objgraph.observation.frames import Frame, Instance
from objgraph.slam.incremental.object_graph import IncrementalObjectGraph
from tests.objgraph.slam.test_incremental import QUICK, UP, chair_at
from tests.toys import look_at, toy_picture, toy_prior

ROUND = 12
"""Frames of a round."""
_CHAIRS = ((-0.6, 0.0, 0.4, (0.6, -0.5, 0.3, 0.2)), (0.6, 0.2, 2.2, (-0.4, 0.5, -0.3, 0.1)))


def rounds() -> Iterator[tuple[Frame, list[Instance]]]:
    """Frames with their detections, round after round."""
    states = [chair_at(*chair) for chair in _CHAIRS]
    seen = []
    for k, bearing in enumerate(np.linspace(0, 2 * np.pi, ROUND, endpoint=False)):
        eye = np.array([2.6 * np.cos(bearing), 2.6 * np.sin(bearing), 1.3])
        frame = toy_picture(states, gtsam.Pose3(look_at(eye, [0, 0, 0.4])).matrix(), str(k), seed=k)
        pixels = [np.count_nonzero(frame.instances == i + 1) for i in range(len(states))]
        seen.append((frame, [Instance(i + 1, "chair") for i, count in enumerate(pixels) if count > 400]))
    number = 0
    while True:
        for frame, detections in seen:
            yield replace(frame, name=str(number)), detections
            number += 1


def mapper(lag: float | None) -> IncrementalObjectGraph:
    """An empty map, with the toy prior."""
    prior = toy_prior()
    return IncrementalObjectGraph(UP, floor=0.0, config=replace(QUICK, lag=lag), find_prior=lambda _: prior)


@dataclass(frozen=True)
class Books:
    """What a map holds."""

    factors: int
    slots: int
    observations: int
    others: int
    variables: int

    @classmethod
    def of(cls, objects: IncrementalObjectGraph) -> "Books":
        smoother, system = objects._smoother, objects.system
        return cls(
            len(smoother._factors),
            smoother._isam.getFactorsUnsafe().size(),
            sum(len(entry.observations) for entry in objects.objects),
            len(system._others),
            smoother.estimate().size(),
        )


def resident_kb() -> float:
    """Memory of this process, garbage collected."""
    gc.collect()
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * 4.096


def slope(values: list[float], every: int) -> float:
    """Growth from one step to the next, by the second half of what was measured every so many."""
    half = values[len(values) // 2 :]
    return float(np.polyfit(every * np.arange(len(half)), half, 1)[0])


def draw(values: list[float], every: int, step: str) -> None:
    """`out/memory_STEP.png` and the numbers in it, for who runs it to look at."""
    folder = Path("out")
    folder.mkdir(exist_ok=True)
    (folder / f"memory_{step}.json").write_text(json.dumps({"every": every, "kB": values}))
    figure = Figure((6, 3), layout="constrained")
    axes = figure.subplots()
    axes.plot(every * np.arange(1, len(values) + 1), np.array(values) / 1e3)
    axes.set(xlabel=f"{step}s", ylabel="memory (MB)", ylim=(0, 1.1e-3 * max(values)))
    figure.savefig(folder / f"memory_{step}.png", dpi=120)
