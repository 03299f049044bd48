"""Check of the direction up: a floor lies below the objects, and the cameras stand upright over it."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from objgraph.doctor.section import Finding, Section
from objgraph.doctor.seen import Seen
from objgraph.maps.pipeline import scene_points
from objgraph.observation.floor import estimate_floor

UNDER = 0.1
"""Share of the objects' points that may lie below the floor: stray ones, and what masks hold of something else."""
BELOW_M = 0.1
"""How far below the floor a point must be to count: twice the thickness of the floor's layer."""
HANGING = -0.3
"""Cosine of up and the pictures' upper side below which a camera hangs upside down: looking straight down it is 0."""
BETTER = 0.3
"""Rise of that cosine from which on another direction may be the right one: 17 degrees from level, more near upright."""
_FRAMES, _PIXELS = 12, 4000
_LOWEST = 2
"""Percentile of an object's heights that is its lower end."""


@dataclass(frozen=True)
class Stance:
    """How the scene stands if a direction is up."""

    up: Float[np.ndarray, "3"]
    floor: float | None
    """Height along `up`, metres."""
    cameras: float
    """Median height of the cameras along `up`, metres."""
    upright: float
    """Median cosine of `up` and the pictures' upper side."""
    under: float = 0.0
    """Share of the objects' points that are below the floor."""
    gap: float = 0.0
    """Height of the median object's lower end above the floor, metres."""

    @property
    def stands(self) -> bool:
        return self.floor is not None and self.under <= UNDER and self.upright >= HANGING

    def beats(self, other: "Stance") -> bool:
        """Whether cameras are clearly more upright and objects nearer to a floor than with another direction."""
        nearer = not other.stands or self.gap < other.gap - BELOW_M
        return self.stands and nearer and self.upright > other.upright + BETTER


def examine_up(seen: Seen) -> tuple[Section, float | None]:
    """The direction up and the floor's height along it, None where none is found."""
    chosen = np.unique(np.linspace(0, len(seen.frames) - 1, _FRAMES).astype(int))
    points, _ = scene_points(seen.scan, chosen, _PIXELS)
    stance = _stance(seen, points, seen.scan.up_world)
    rows = [("up", _vector(stance.up))]
    if stance.floor is not None:
        rows.append(
            (
                "floor",
                f"at {stance.floor:.2f} m along up, {stance.cameras - stance.floor:.2f} m below the cameras",
            )
        )
    rows.append(("cameras", f"the pictures' upper side is {_degrees(stance.upright):.0f} degrees from up"))
    if stance.floor is not None:
        rows.append(("objects", f"the median one's lowest point is {stance.gap:.2f} m above the floor"))
    others = [_stance(seen, points, direction) for direction in np.concatenate([np.eye(3), -np.eye(3)])]
    better = max((other for other in others if other.beats(stance)), key=lambda s: s.upright, default=None)
    return Section("Up and floor", tuple(rows), tuple(_verdict(stance, better))), stance.floor


def _verdict(stance: Stance, better: Stance | None) -> Iterator[Finding]:
    if stance.stands and better is None:
        return
    if stance.floor is None:
        what = "no floor is found below the objects along up"
    elif stance.under > UNDER:
        what = f"{stance.under:.0%} of the objects' points are below the floor"
    elif stance.upright < HANGING:
        what = "the cameras hang upside down"
    else:
        what = "cameras and objects do not stand as up says"
    do = "set up_world to the direction against gravity in the world of the poses"
    if better is not None:
        what += f"; with {_vector(better.up)} up they stand upright on a floor"
        do += f": {_vector(better.up)}, as it seems"
    elif stance.floor is None:
        do += "; where it is right and no floor is in the pictures, objects are mapped without one"
    yield Finding("up_world", what, do)


def _stance(seen: Seen, points: Float[np.ndarray, "n 3"], up: Float[np.ndarray, "3"]) -> Stance:
    poses = np.stack([frame.T_world_camera for frame in seen.frames])
    cameras, upright = float(np.median(poses[:, :3, 3] @ up)), float(np.median(-poses[:, :3, 1] @ up))
    floor = estimate_floor(points, up)
    heights = [] if floor is None else [each @ up - floor for each in _objects(seen)]
    if not heights:
        return Stance(up, floor, cameras, upright)
    under = float((np.concatenate(heights) < -BELOW_M).mean())
    gap = float(np.median([np.percentile(each, _LOWEST) for each in heights]))
    return Stance(up, floor, cameras, upright, under, gap)


def _objects(seen: Seen) -> list[Float[np.ndarray, "n 3"]]:
    """Points of each object."""
    found = []
    for instance in seen.scan.instances:
        parts = [frame.points[instance.id] for frame in seen.frames if instance.id in frame.points]
        if parts:
            found.append(np.concatenate(parts))
    return found


def _degrees(cosine: float) -> float:
    return float(np.degrees(np.arccos(np.clip(cosine, -1, 1))))


def _vector(v: Float[np.ndarray, "3"]) -> str:
    return "[" + ", ".join(f"{x + 0.0:.3g}" for x in v) + "]"
