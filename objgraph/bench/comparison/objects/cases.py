"""What a comparison asks of an object to be reconstructed, and of where such objects come from; the synthetic ones."""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Protocol

from objgraph.bench.worlds.cases import BenchmarkConfig, synthetic_cases
from objgraph.datasets.ground_truth import AnnotatedScan
from objgraph.observation.frames import Instance

SYNTHETIC = "synthetic"
"""The data set's name."""


class Case(Protocol):
    """One object in one scan. It is sent to other processes, so it is small and can be pickled."""

    @property
    def id(self) -> str:
        """Unique in its data set."""
        ...

    @property
    def category(self) -> str: ...

    @property
    def shape(self) -> str:
        """Objects with equal ones have the same CAD model, and are no independent evidence."""
        ...

    @property
    def difficulty(self) -> str:
        """Of a synthetic scan; empty for another."""
        ...

    @property
    def shapes(self) -> str:
        """The set that its shape is of, where there are several."""
        ...

    @property
    def instance(self) -> Instance: ...

    def scan(self) -> AnnotatedScan:
        """The scan, with ground truth of the instance; always the same."""
        ...

    def views(self, count: int) -> tuple[int, ...]:
        """Indices of at most `count` frames that observe the object; may raise `ObservationError`."""
        ...


class CaseSource(Protocol):
    """A data set, or a selection of it."""

    @property
    def dataset(self) -> str: ...

    def settings(self) -> dict[str, Any]:
        """All that decides what a case of a given id is; JSON values."""
        ...

    def cases(self, progress: Callable[[int, int], None] | None = None) -> Sequence[Case]:
        """The objects, in an order that does not change; `progress` gets how many scans are read, of how many."""
        ...


@dataclass(frozen=True)
class SyntheticSource:
    """Cases that are made when they are asked for."""

    config: BenchmarkConfig

    @property
    def dataset(self) -> str:
        return SYNTHETIC

    def settings(self) -> dict[str, Any]:
        """All of the configuration but which of its cases are taken, so that a benchmark may grow."""
        meshes = self.config.meshes
        return {
            "seed": self.config.seed,
            "spacing": self.config.spacing,
            "difficulty": self.config.difficulty,
            "faults": None if self.config.ranges is None else asdict(self.config.ranges),
            "shapes": self.config.shapes,
            "meshes": None if meshes is None else str(meshes.resolve()),
            "sensor": asdict(self.config.sensor),
        }

    def cases(self, progress: Callable[[int, int], None] | None = None) -> Sequence[Case]:
        """See `synthetic_cases`; nothing is read, so that there is no progress to tell."""
        return synthetic_cases(self.config)
