"""Where the map's objects are, so that those near a place are found without going through all."""

import itertools
from typing import Generic, TypeVar

import numpy as np
from jaxtyping import Float

_EDGE = 4.0
"""Of the cubes into which space is cut, metres."""

Cube = tuple[int, int, int]
T = TypeVar("T")


class Places(Generic[T]):
    """Things at points, by name; the cost of a look-up does not grow with how many there are."""

    def __init__(self) -> None:
        self._points: dict[str, Float[np.ndarray, 3]] = {}
        self._things: dict[str, T] = {}
        self._cubes: dict[Cube, dict[str, None]] = {}

    def __contains__(self, name: str) -> bool:
        return name in self._points

    def put(self, name: str, thing: T, point: Float[np.ndarray, "3"]) -> None:
        """Add a thing, or move it."""
        if name in self._points:
            self.remove(name)
        self._points[name], self._things[name] = np.array(point), thing
        self._cubes.setdefault(_cube(self._points[name]), {})[name] = None

    def remove(self, name: str) -> None:
        cube = _cube(self._points.pop(name))
        del self._cubes[cube][name], self._things[name]
        if not self._cubes[cube]:
            del self._cubes[cube]

    def near(self, points: Float[np.ndarray, "n 3"], distance: float) -> list[T]:
        """What is nearer than `distance` (metres) to one of `points`, by name."""
        reach = range(-int(np.ceil(distance / _EDGE)), int(np.ceil(distance / _EDGE)) + 1)
        found = set()
        for point in points:
            x, y, z = _cube(point)
            for i, j, k in itertools.product(reach, repeat=3):
                for name in self._cubes.get((x + i, y + j, z + k), ()):
                    if np.linalg.norm(self._points[name] - point) < distance:
                        found.add(name)
        return [self._things[name] for name in sorted(found)]


def _cube(point: Float[np.ndarray, "3"]) -> Cube:
    x, y, z = np.floor(point / _EDGE).astype(int).tolist()
    return x, y, z
