"""One id for one object in all frames: masks of single images are joined where their points meet in the world."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import cv2
import numpy as np
from jaxtyping import Int
from scipy.optimize import linear_sum_assignment

from objgraph.geometry.frames import transformed
from objgraph.observation.frames import Frame, FrameSource

Voxels = frozenset[tuple[int, int, int]]


@dataclass(frozen=True)
class LinkConfig:
    """When two masks are of one object."""

    voxel: float = 0.06
    """Edge of the cells that seen surface is counted in, metres."""
    overlap: float = 0.25
    """Share of the smaller one's cells that both have."""
    frames: int = 2
    """Objects seen in fewer are dropped, where there are as many frames."""
    border: int = 3
    """Pixels at a mask's outline that may show what is behind."""
    max_depth: float = 8.0


@dataclass
class _Track:
    category: str
    voxels: set[tuple[int, int, int]] = field(default_factory=set)
    members: list[tuple[int, int]] = field(default_factory=list)
    """Frame and id in its mask."""


@dataclass(frozen=True)
class Linked:
    """The objects of a scan."""

    categories: dict[int, str]
    """By id, from 1 on."""
    ids: dict[tuple[int, int], int]
    """By frame and the id that its own mask has; what was dropped is missing."""

    def relabelled(self, frame: int, instances: Int[np.ndarray, "h w"]) -> Int[np.ndarray, "h w"]:
        """A frame's mask with the objects' ids."""
        table = np.zeros(int(instances.max()) + 1, np.uint16)
        for number in range(1, len(table)):
            table[number] = self.ids.get((frame, number), 0)
        return table[instances]


def link(
    frames: FrameSource,
    categories: Sequence[Mapping[int, str]],
    config: LinkConfig | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Linked:
    """Join the masks of all frames; `categories` says for each frame what its masks' ids are."""
    config = config or LinkConfig()
    tracks: list[_Track] = []
    for index in range(len(frames)):
        _extend(tracks, index, frames[index], categories[index], config)
        if progress is not None:
            progress(index + 1, len(frames))
    tracks = _merged(tracks, config.overlap)
    least = min(config.frames, len(frames))
    kept = [track for track in tracks if len({frame for frame, _ in track.members}) >= least]
    return Linked(
        {i: track.category for i, track in enumerate(kept, 1)},
        {member: i for i, track in enumerate(kept, 1) for member in track.members},
    )


def _extend(
    tracks: list[_Track], index: int, frame: Frame, categories: Mapping[int, str], config: LinkConfig
) -> None:
    """Each mask of a frame goes to the object that it meets most, or begins one."""
    seen = {number: _voxels(frame, number, config) for number in categories}
    seen = {number: voxels for number, voxels in seen.items() if voxels}
    numbers = list(seen)
    meeting = np.zeros((len(numbers), len(tracks)))
    for i, number in enumerate(numbers):
        for j, track in enumerate(tracks):
            if track.category == categories[number]:
                meeting[i, j] = _overlap(seen[number], track.voxels)
    joined = {
        numbers[i]: tracks[j]
        for i, j in zip(*linear_sum_assignment(-meeting), strict=True)
        if meeting[i, j] >= config.overlap
    }
    for number in numbers:
        if number not in joined:
            joined[number] = _Track(categories[number])
            tracks.append(joined[number])
        joined[number].voxels |= seen[number]
        joined[number].members.append((index, number))


def _merged(tracks: Sequence[_Track], overlap: float) -> list[_Track]:
    """Objects that were begun twice and have grown together, joined; the largest takes the others."""
    kept: list[_Track] = []
    for track in sorted(tracks, key=lambda each: -len(each.voxels)):
        for other in kept:
            if other.category == track.category and _overlap(track.voxels, other.voxels) >= 2 * overlap:
                other.voxels |= track.voxels
                other.members += track.members
                break
        else:
            kept.append(track)
    return sorted(kept, key=lambda each: min(each.members))


def _overlap(a: Voxels | set, b: set) -> float:
    return len(a & b) / max(min(len(a), len(b)), 1)


def _voxels(frame: Frame, number: int, config: LinkConfig) -> set[tuple[int, int, int]]:
    """World cells of a mask's points, without its outline."""
    mask = (frame.instances == number).astype(np.uint8)
    size = 2 * config.border + 1
    inner = cv2.erode(mask, np.ones((size, size), np.uint8)) if config.border else mask
    v, u = np.nonzero((inner > 0) & (frame.depth > 0) & (frame.depth < config.max_depth))
    p_camera = frame.intrinsics.backproject(u, v) * frame.depth[v, u, None]
    p_world = transformed(frame.T_world_camera, p_camera)
    cells, counts = np.unique(np.floor(p_world / config.voxel).astype(int), axis=0, return_counts=True)
    return {(int(x), int(y), int(z)) for x, y, z in cells[counts > 1]}
