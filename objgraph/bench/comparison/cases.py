"""What a comparison asks of an object to be reconstructed, and of where such objects come from."""

from collections.abc import Callable, Sequence
from typing import Any, Protocol

from objgraph.datasets.ground_truth import AnnotatedScan
from objgraph.observation.frames import Instance


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
