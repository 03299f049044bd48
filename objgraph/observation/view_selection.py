"""Which frames observe an object: a fixed rule from masks, depth and poses, without any ground truth."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from factors import checks
from objgraph.errors import ConfigError, ObservationError
from objgraph.geometry.frames import transformed
from objgraph.geometry.voxels import voxel_keys
from objgraph.observation.frames import Frame, FrameSource, frame_of

_REFERENCE_PIXELS = 640 * 480


@dataclass(frozen=True)
class ViewSelectionConfig:
    """The rule of view selection; see `ViewIndex.select`."""

    min_pixels: int = 1500
    """Mask pixels with depth below which a frame does not count, at 640x480; scaled with the image's area."""
    voxel: float = 0.03
    """Edge of the cells that seen surface is counted in, metres."""
    full_angle: float = np.pi / 3
    """Angle between viewing directions from which on a frame counts as seen from elsewhere, radians."""
    angle_floor: float = 0.2
    """Weight of a frame that looks from the same direction as one already chosen."""
    border: int = 2
    """Pixels this close to the image's edge are where a mask is cut."""
    border_penalty: float = 0.8
    """Share of its worth that a frame loses when the image's edge cuts the object along its whole width."""
    max_depth: float = 8.0
    """Depth beyond which pixels are not counted, metres."""

    def __post_init__(self) -> None:
        """Raises ConfigError where a number is not one of its kind."""
        share, some = checks.Range(0, 1), checks.Range(1e-3, 1e4)
        checks.settings(
            self, ConfigError, voxel=some, full_angle=checks.Range(1e-3, 4), angle_floor=share,
            border=checks.Range(1), border_penalty=share, max_depth=some,
        )  # fmt: skip


@dataclass(frozen=True)
class InstanceView:
    """What one frame sees of one instance."""

    frame: int
    """Index into the frame source."""
    pixels: float
    """Mask pixels with depth, scaled to an image of 640x480."""
    cut: float
    """Length of the mask's cut at the image's edge over the mask's width (root of its pixels), at most 1."""
    voxels: Int[np.ndarray, "n"]
    """Sorted keys of the cells, in the world, that hold a seen point."""
    direction_world: Float[np.ndarray, "3"]
    """Unit vector from the seen points' middle to the camera."""


class ViewIndex:
    """Summaries of all frames of a scan by instance: views are chosen without reading a frame again."""

    def __init__(self, views: Mapping[int, Sequence[InstanceView]], config: ViewSelectionConfig) -> None:
        self.views = views
        self.config = config

    def select(self, instance_id: int, count: int) -> list[int]:
        """Indices of at most `count` frames for an instance, the best first.

        Greedy, by a frame's worth `(1 - border_penalty * cut) * gain`:
        1. Only frames with at least `min_pixels` mask pixels with depth compete; where there is none, all do.
        2. First the frame of largest worth, its gain being the number of mask pixels with depth.
        3. Then, again and again, the frame of largest worth, its gain being the number of 3 cm voxels that no
           chosen frame has seen, weighted by the angle to the nearest viewing direction chosen before
           (rising from `angle_floor` to 1 at `full_angle`). A frame without new voxels is never chosen.
        Equal worth goes to the earlier frame. Raises `ObservationError` where no frame sees the instance.
        """
        if count < 1:
            raise ObservationError(f"instance {instance_id}: {count} views asked for; at least one is needed")
        views = self.views.get(instance_id, ())
        if not views:
            raise ObservationError(
                f"instance {instance_id}: no frame has mask pixels of it with depth within {self.config.max_depth:g} m "
                "(depths must be metres; millimetres: divide by 1000)"
            )
        candidates = [view for view in views if view.pixels >= self.config.min_pixels] or list(views)
        chosen = [max(candidates, key=lambda view: self._uncut(view) * view.pixels)]
        seen = chosen[0].voxels
        while len(chosen) < count:
            worths = [self._worth(view, chosen, seen) for view in candidates]
            best = int(np.argmax(worths))
            if worths[best] <= 0:
                break
            chosen.append(candidates[best])
            seen = np.union1d(seen, candidates[best].voxels)
        return [view.frame for view in chosen]

    def _uncut(self, view: InstanceView) -> float:
        return 1 - self.config.border_penalty * view.cut

    def _worth(self, view: InstanceView, chosen: list[InstanceView], seen: Int[np.ndarray, "n"]) -> float:
        new = len(view.voxels) - np.isin(view.voxels, seen, assume_unique=True).sum()
        cosine = max(float(view.direction_world @ other.direction_world) for other in chosen)
        share = min(1.0, float(np.arccos(np.clip(cosine, -1, 1))) / self.config.full_angle)
        return self._uncut(view) * new * (self.config.angle_floor + (1 - self.config.angle_floor) * share)


def summarize(
    frames: FrameSource,
    config: ViewSelectionConfig | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> ViewIndex:
    """Read every frame once and summarise what it sees of every instance.

    `progress` is called after each frame with the number read and the number of all.
    """
    config = checks.settings_or_default(config, ViewSelectionConfig, ConfigError)
    views: dict[int, list[InstanceView]] = {}
    for index in range(len(frames)):
        for instance_id, view in _summarize_frame(index, frame_of(frames, index), config):
            views.setdefault(instance_id, []).append(view)
        if progress is not None:
            progress(index + 1, len(frames))
    return ViewIndex(views, config)


def _summarize_frame(index: int, frame: Frame, config: ViewSelectionConfig) -> list[tuple[int, InstanceView]]:
    """What a frame sees of each instance of which it has pixels with depth."""
    depth, masks = frame.depth, frame.instances
    if not np.isfinite(frame.T_world_camera).all():
        return []
    # a comparison with NaN is false, so unmeasured pixels drop out
    v, u = np.nonzero((depth > 0) & (depth < config.max_depth) & (masks > 0))
    p_camera = frame.intrinsics.backproject(u, v) * depth[v, u, None]
    T_world_camera = frame.T_world_camera
    p_world = transformed(T_world_camera, p_camera)
    ids = masks[v, u]
    areas = np.bincount(masks[masks > 0])
    cuts = np.bincount(masks[_edge(depth.shape, config.border) & (masks > 0)], minlength=len(areas))
    views = []
    for instance_id in np.unique(ids):
        points = p_world[ids == instance_id]
        to_camera = T_world_camera[:3, 3] - np.median(points, axis=0)
        view = InstanceView(
            frame=index,
            pixels=len(points) * _REFERENCE_PIXELS / depth.size,
            cut=min(1.0, float(cuts[instance_id] / (config.border * np.sqrt(areas[instance_id])))),
            voxels=np.unique(voxel_keys(points, config.voxel)),
            direction_world=to_camera / max(float(np.linalg.norm(to_camera)), 1e-9),
        )
        views.append((int(instance_id), view))
    return views


def _edge(shape: tuple[int, ...], border: int) -> Bool[np.ndarray, "h w"]:
    edge = np.ones(shape, dtype=bool)
    edge[border : shape[0] - border, border : shape[1] - border] = False
    return edge
