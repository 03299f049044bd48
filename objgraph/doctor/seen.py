"""One pass over a scan's frames: what each of them shows, and those that cannot be read."""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

from objgraph.doctor.section import Finding, listed
from objgraph.errors import ObjectGraphError
from objgraph.geometry.frames import transformed
from objgraph.observation.frames import Frame, FrameSource, Intrinsics, Scan

_POINTS = 50
"""Points kept of an object in a frame: a scan may have thousands of frames."""
_STRIDE = 16
"""Every so many-th pixel with depth is looked at for the depths' distribution."""


@dataclass(frozen=True)
class SeenFrame:
    """What is kept of a frame."""

    name: str
    intrinsics: Intrinsics
    T_world_camera: Float[np.ndarray, "4 4"]
    depths: Float[np.ndarray, "3"]
    """5 %, 50 % and 95 % of the depths, metres; zeros where there are none."""
    measured: float
    """Share of the pixels that have depth."""
    levels: int
    """Different depths."""
    pixels: dict[int, int]
    """Of the mask, by instance id."""
    pixels_with_depth: dict[int, int]
    points: dict[int, Float[np.ndarray, "n 3"]]
    """Some world points, by instance id."""


@dataclass(frozen=True)
class Seen:
    """A scan with the frames that can be read alone, and what they show."""

    scan: Scan
    frames: tuple[SeenFrame, ...]
    findings: tuple[Finding, ...]
    """Frames that cannot be read."""

    @property
    def depths(self) -> Float[np.ndarray, "3"]:
        """5 %, 50 % and 95 % of the depths in the median frame, metres; zeros where no frame has depth."""
        measured = [frame.depths for frame in self.frames if frame.measured > 0]
        return np.median(measured, axis=0) if measured else np.zeros(3)


class Subset(FrameSource):
    """Some of another source's frames."""

    def __init__(self, frames: FrameSource, indices: Sequence[int], names: Sequence[str]) -> None:
        self._frames, self._indices, self._names = frames, indices, tuple(names)

    @property
    def names(self) -> tuple[str, ...]:
        return self._names

    def __len__(self) -> int:
        return len(self._indices)

    def __getitem__(self, index: int) -> Frame:
        return self._frames[self._indices[index]]


def look(scan: Scan, progress: Callable[[int, int], None] | None = None) -> Seen:
    """Read every frame once; one that cannot be read is a finding and stops no other."""
    frames, indices = [], []
    alike: dict[str, tuple[str, list[str]]] = {}
    for i, name in enumerate(scan.frames.names):
        try:
            frames.append(_seen(scan.frames[i]))
            indices.append(i)
        except ObjectGraphError as error:
            message = str(error)
            kind = re.sub(rf"[/\\]{re.escape(name)}\.", "/", message)  # but for the file's name
            alike.setdefault(kind, (message, []))[1].append(name)
        if progress is not None:
            progress(i + 1, len(scan.frames))
    readable = Subset(scan.frames, indices, [frame.name for frame in frames])
    findings = tuple(Finding(_frames(names), message) for message, names in alike.values())
    return Seen(replace(scan, frames=readable), tuple(frames), findings)


def _frames(names: list[str]) -> str:
    return f"frame {names[0]}" if len(names) == 1 else f"{len(names)} frames ({listed(names)})"


def _seen(frame: Frame) -> SeenFrame:
    known = np.isfinite(frame.depth) & (frame.depth > 0)
    some = frame.depth[known][::_STRIDE]
    pixels = _counts(frame, np.ones_like(known))
    with_depth = _counts(frame, known)
    return SeenFrame(
        name=frame.name,
        intrinsics=frame.intrinsics,
        T_world_camera=frame.T_world_camera,
        depths=np.percentile(some, (5, 50, 95)) if len(some) else np.zeros(3),
        measured=float(known.mean()),
        levels=len(np.unique(some)),
        pixels=pixels,
        pixels_with_depth={i: with_depth.get(i, 0) for i in pixels},
        points={i: _points(frame, known & (frame.instances == i)) for i in with_depth},
    )


def _counts(frame: Frame, where: Bool[np.ndarray, "h w"]) -> dict[int, int]:
    counts = np.bincount(frame.instances[where & (frame.instances > 0)])
    return {int(i): int(counts[i]) for i in np.flatnonzero(counts)}


def _points(frame: Frame, chosen: Bool[np.ndarray, "h w"]) -> Float[np.ndarray, "n 3"]:
    v, u = np.nonzero(chosen)
    some = np.linspace(0, len(v) - 1, min(_POINTS, len(v))).astype(int)
    v, u = v[some], u[some]
    p_camera = frame.intrinsics.backproject(u, v) * frame.depth[v, u, None]
    return transformed(frame.T_world_camera, p_camera).astype(np.float32)
