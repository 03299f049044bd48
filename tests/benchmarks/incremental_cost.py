"""Where the time of an incremental map's update goes as the map grows: python -m tests.benchmarks.incremental_cost 10 1000

On the row of crates of `objgraph bench --parts updates`. The parts of an update do not contain each other:

- association: of detections to objects, without the smoother's covariances;
- local: the camera and what it sees are solved with the decoder, against the map's marginal;
- smoother: everything that is asked of ISAM2;
- upkeep: observations linearised anew, without the smoother's part;
- rest: points and rays are drawn from the images.
"""

import sys
import time
from collections.abc import Callable

import numpy as np
import torch

from objgraph.bench.speed.updates import map_of, solved_crates, updates
from objgraph.slam.incremental import front_end
from objgraph.slam.incremental.object_graph import IncrementalObjectGraph

SEEN = 10
"""Updates that are timed."""
PARTS = ("association", "local", "smoother", "upkeep", "rest")


class Clock:
    """Seconds by parts; what one part spends in another is the other's."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._inner: list[float] = []

    def watch(self, part: str, owner: object, *names: str) -> None:
        """Count all further calls of these functions of `owner` as `part`."""
        for name in names:
            setattr(owner, name, self.timed(part, getattr(owner, name)))

    def timed(self, part: str, function: Callable) -> Callable:
        def call(*args, **kwargs):
            self._inner.append(0.0)
            start = time.process_time()
            try:
                return function(*args, **kwargs)
            finally:
                spent = time.process_time() - start
                self.seconds[part] = self.seconds.get(part, 0.0) + spent - self._inner.pop()
                if self._inner:
                    self._inner[-1] += spent

        return call


def by_parts(objects: IncrementalObjectGraph) -> dict[str, float]:
    """Milliseconds an update, by its parts, while the camera sees the last crates again."""
    clock, system = Clock(), objects.system
    clock.watch(
        "smoother", system.smoother, "update", "marginal_factors", "covariance", "pose", "vector", "has"
    )
    clock.watch("local", system, "solved")
    clock.watch("upkeep", objects, "keep_current")
    clock.watch("rest", objects, "update")
    associate = front_end.associate
    clock.watch("association", front_end, "associate")
    try:
        timed = updates(objects, SEEN)
    finally:
        front_end.associate = associate
    assert len(timed) == SEEN
    return {part: 1e3 * clock.seconds.get(part, 0.0) / SEEN for part in PARTS}


def main(counts: list[int]) -> None:
    torch.set_num_threads(1)
    solved = solved_crates()
    print("objects  update, ms" + "".join(f"{part:>13}" for part in PARTS))
    for count in counts:
        spent = by_parts(map_of(count, solved))
        row = "".join(f"{each:13.1f}" for each in spent.values())
        print(f"{count:7d} {np.sum(list(spent.values())):11.0f}{row}", flush=True)


if __name__ == "__main__":
    main([int(word) for word in sys.argv[1:]] or [10, 100, 1000])
