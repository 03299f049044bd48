"""The project's synthetic benchmark as a source of cases."""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from objgraph.bench.worlds.cases import BenchmarkConfig, Case, synthetic_cases

SYNTHETIC = "synthetic"
"""The data set's name."""


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
            "meshes": None if meshes is None else str(meshes.resolve()),
            "sensor": asdict(self.config.sensor),
        }

    def cases(self, progress: Callable[[int, int], None] | None = None) -> Sequence[Case]:
        """See `synthetic_cases`; nothing is read, so that there is no progress to tell."""
        return synthetic_cases(self.config)
