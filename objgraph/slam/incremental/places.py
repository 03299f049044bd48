"""Where the map's objects are, so that those near a place are found without going through all."""

from collections.abc import Iterable, Sequence
from typing import Generic, TypeVar

import numpy as np
from jaxtyping import Float
from scipy.spatial import cKDTree

from objgraph.observation.sampling import ObjectView
from objgraph.slam.incremental.system import IncrementalSystem
from objgraph.slam.incremental.tracked import TrackedObject

T = TypeVar("T")
_LARGEST = 3.0
"""Metres between an object's centre and what a view sees of it, at most."""


class Places(Generic[T]):
    """Things at points, by name."""

    def __init__(self) -> None:
        self._points: dict[str, Float[np.ndarray, 3]] = {}
        self._things: dict[str, T] = {}
        self._tree: cKDTree | None = None

    def __contains__(self, name: str) -> bool:
        return name in self._points

    def put(self, name: str, thing: T, point: Float[np.ndarray, "3"]) -> None:
        """Add a thing, or move it."""
        self._points[name], self._things[name], self._tree = np.array(point), thing, None

    def remove(self, name: str) -> None:
        del self._points[name], self._things[name]
        self._tree = None

    def near(self, points: Float[np.ndarray, "n 3"], distance: float) -> list[T]:
        """What is nearer than `distance` (metres) to one of `points`, by name."""
        if not self._points or not len(points):
            return []
        tree = self._tree or cKDTree(np.stack([*self._points.values()]))
        self._tree = tree  # until something moves
        # a ball holds its surface, what is asked for is nearer
        within = tree.query_ball_point(points, np.nextafter(distance, 0.0))
        names = [*self._points]
        return [self._things[name] for name in sorted({names[i] for found in within for i in found})]


class ObjectPlaces(Places[TrackedObject]):
    """The map's objects at their centres, as these last were noted."""

    def __init__(self, system: IncrementalSystem) -> None:
        super().__init__()
        self._system = system

    def note(self, entries: Iterable[TrackedObject]) -> None:
        """Note where these are now."""
        for entry in entries:
            self.put(entry.name, entry, self._system.pose(entry.keys.pose).translation())

    def of(self, views: Sequence[ObjectView]) -> list[TrackedObject]:
        """Objects that views may be of."""
        within = _LARGEST + self._system.config.association.reach
        return self.near(np.array([view.points_world.mean(axis=0) for view in views]), within)
