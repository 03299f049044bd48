"""RGB-D recordings of robots: ROS 1 bags, ROS 2 bags and MCAP files, with instance masks.

Expected in a folder: one bag (`NAME.bag`, `NAME.mcap`, `NAME.db3`, or a folder with `metadata.yaml`) and beside it
`masks/SECONDS.NANOSECONDS.png`, called after the stamps of depth images with nine digits behind the point
(`1305031102.160407000`), and `instances.json`; both are those of the plain folder (`folder.py`). Depth is registered to
the camera of the info topic. Lens distortion is not corrected.
"""

import logging
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Self

import numpy as np
from jaxtyping import Float

from objgraph.datasets.bag.images import color_of, depth_of
from objgraph.datasets.bag.index import read_camera, read_index
from objgraph.datasets.bag.poses import WORLDS, camera_chain
from objgraph.datasets.bag.reader import Bag, Moment, bags
from objgraph.datasets.bag.topics import NONE, Topics, choose
from objgraph.datasets.files import (
    LazyFrames,
    fitted,
    intrinsics_from,
    pick_scene,
    same_proportions,
)
from objgraph.datasets.folder_files import Camera, mask_paths, read_instances, read_masks
from objgraph.datasets.trajectory import interpolate, read_tum
from objgraph.errors import DatasetError
from objgraph.observation.frames import Frame, Scan

log = logging.getLogger(__name__)

MAX_POSE_DIFFERENCE = 0.1
"""Seconds between a frame and the poses before and after it."""


def scenes(root: Path) -> list[str]:
    """Names of the bags: `root` itself, those in it, or the one of each folder in it."""
    return list(bags(root))


def load(
    root: Path,
    scene: str | None = None,
    *,
    stride: int = 1,
    trajectory: Path | None = None,
    depth_topic: str | None = None,
    color_topic: str | None = None,
    info_topic: str | None = None,
    pose_topic: str | None = None,
    world_frame: str | None = None,
    max_difference: float = MAX_POSE_DIFFERENCE,
) -> Scan:
    """The bag at `root`, or the bag `scene` there; it has no ground truth.

    A frame is a depth image with a mask and a pose; others are left out with a warning. `stride` keeps every
    stride-th of those with a mask. Poses are interpolated between those before and after, which are at most
    `max_difference` seconds away. `trajectory` (T_world_camera, TUM format) is read in place of the bag's poses. Topics
    that are not named are guessed by type and name, and logged; `color_topic` may be "none". `world_frame` is that of
    the poses, by default the topmost called map, odom or world. Without `up_world` in `instances.json` the z axis of a
    world of these names is up. Raises `DatasetError` for what is missing or damaged, here or when a frame is read.
    """
    if stride < 1:
        raise DatasetError(f"stride {stride}: must be 1 or more")
    path = pick_bag(root, scene)
    recording = Recording.read(
        path,
        trajectory,
        max_difference,
        depth_topic=depth_topic,
        color_topic=color_topic,
        info_topic=info_topic,
        pose_topic=pose_topic,
        world_frame=world_frame,
    )
    masks = mask_paths(path.parent, {name: (name,) for name in recording.depth})
    up_world, instances = read_instances(path.parent / "instances.json", recording.up_world)
    return Scan(
        path.resolve().name, recording.frames(dict(list(masks.items())[::stride])), instances, up_world
    )


def pick_bag(root: Path, scene: str | None) -> Path:
    """The bag of a scene, or the only one; raises DatasetError."""
    found = bags(root)
    if not found:
        raise DatasetError(
            f"{root}: holds no bag; a .bag, .mcap or .db3 file or a folder with metadata.yaml is one"
        )
    return found[pick_scene(list(found), scene, root)]


@dataclass(frozen=True)
class Recording:
    """A bag, and what is to be read of it."""

    bag: Bag
    topics: Topics
    camera: Camera
    depth: Mapping[str, Moment]
    """By frame name, in order of time."""
    colors: Mapping[str, Moment]
    """Of those that have a colour image near in time."""
    poses: Mapping[str, Float[np.ndarray, "4 4"]]
    """T_world_camera of those that have one."""
    world: str | None
    """The poses' world frame; None where nobody says."""

    @classmethod
    def read(
        cls,
        path: Path,
        trajectory: Path | None = None,
        max_difference: float = MAX_POSE_DIFFERENCE,
        *,
        world_frame: str | None = None,
        **named: str | None,
    ) -> Self:
        """Read the bag through once; `named` are the topics, by the names of `load`.

        Raises:
            DatasetError: see `load`.
        """
        bag = Bag(path)
        topics = choose(bag.topics, path, **named)
        index = read_index(bag, topics)
        camera = read_camera(bag, topics, index.frames)
        times = np.array([moment.stamp for moment in index.depth.values()]) / 1e9
        if trajectory is None:
            frame = index.frames[topics.depth]
            who, tf, chain = camera_chain(index.tf, index.others, frame, world_frame, path, topics.is_named)
            poses, world = tf.poses(chain, times, max_difference), chain[-1]
            source = f"{who} ({' < '.join(chain)})"
        else:
            poses = interpolate(read_tum(trajectory), times, max_difference)
            world, source = world_frame, str(trajectory)
        if not all(named.get(f"{kind}_topic") for kind in ("depth", "color", "info", "pose")):
            log.warning(
                "%s: depth of %s, colour of %s, camera of %s, poses of %s; --topic names others",
                path, topics.depth, topics.color or NONE, topics.info, source,
            )  # fmt: skip
        known = {name: T for name, T in zip(index.depth, poses, strict=True) if np.isfinite(T).all()}
        return cls(bag, topics, camera, index.depth, index.colors, known, world)

    @property
    def up_world(self) -> Float[np.ndarray, "3"] | None:
        """Where the world's name tells it."""
        return np.array([0.0, 0.0, 1.0]) if self.world in WORLDS else None

    def frames(self, masks: Mapping[str, Path]) -> LazyFrames:
        """Frames of these masks, read on demand; those without a pose are left out with a warning.

        Raises:
            DatasetError: none has a pose.
        """
        names = [name for name in masks if name in self.poses]
        if not names:
            first, last = next(iter(masks)), list(masks)[-1]
            raise DatasetError(
                f"{self.bag.path}: none of the {len(masks)} frames with masks, from {first} to {last} s, lies between "
                "two poses that are near enough in time (in Python: max_difference)"
            )
        if len(names) < len(masks):
            lost = len(masks) - len(names)
            log.warning("%s: %d of %d frames have no pose and are left out", self.bag.path, lost, len(masks))
        return LazyFrames(names, lambda name: self._frame(name, masks[name]))

    def color(self, name: str) -> np.ndarray | None:
        """RGB, as large as it was recorded; None where there is no image near in time."""
        if name not in self.colors or self.topics.color is None:
            return None
        message = self.bag.message(self.topics.color, self.colors[name])
        return color_of(message, f"{self.bag.path}: {self.topics.color} of {name}")

    def _frame(self, name: str, mask: Path) -> Frame:
        origin = f"{self.bag.path}: {self.topics.depth} of {name}"
        depth = depth_of(self.bag.message(self.topics.depth, self.depth[name]), origin)
        height, width = depth.shape
        color = self.color(name)
        if color is not None and not same_proportions((color.shape[0], color.shape[1]), (height, width)):
            raise DatasetError(
                f"{origin}: {width}x{height} pixels, and its colour {color.shape[1]}x{color.shape[0]}: other proportions, "
                "so not one view; name the topic of depth that is registered to colour (--topic.depth)"
            )
        return Frame(
            name=name,
            depth=depth,
            intrinsics=intrinsics_from(
                self.camera.matrix, self.camera.origin, width, height, self.camera.size
            ),
            T_world_camera=self.poses[name],
            instances=read_masks(mask, depth.shape),
            color=None if color is None else fitted(color, depth.shape),
        )
