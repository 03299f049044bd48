"""What one pass over a bag finds: when its images were made, whose they are, and all transforms."""

import logging
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from objgraph.datasets.bag.images import camera_matrix, is_distorted
from objgraph.datasets.bag.poses import Transforms
from objgraph.datasets.bag.reader import Bag, Moment, frame_of, stamp
from objgraph.datasets.bag.topics import ODOMETRY, Topics, is_fixed
from objgraph.datasets.folder_files import Camera
from objgraph.datasets.trajectory import MAX_DIFFERENCE
from objgraph.errors import DatasetError

log = logging.getLogger(__name__)


@dataclass
class Index:
    """Images stay in the bag."""

    depth: dict[str, Moment]
    """By frame name, in order of time."""
    colors: dict[str, Moment]
    """The same, of the frames that have a colour image near in time."""
    frames: dict[str, str]
    """Coordinate frame of each image topic."""
    tf: Transforms
    others: dict[str, Transforms] = field(default_factory=dict)
    """By topic of odometry or poses; a pose is the camera's."""


def read_index(bag: Bag, topics: Topics) -> Index:
    """Read the bag through once.

    Raises:
        DatasetError: it is damaged, or its images have no time.
    """
    images = [topic for topic in (topics.depth, topics.color) if topic is not None]
    moments: dict[str, list[Moment]] = {topic: [] for topic in images}
    frames: dict[str, str] = {}
    tf = Transforms(bag.path)
    poses: list[tuple[str, str | None, str, float, Any]] = []
    for topic, logged, message in bag.messages({*images, *topics.transforms, *topics.poses}):
        if topic in moments:
            moments[topic].append(Moment(stamp(message), logged))
            frames.setdefault(topic, frame_of(message))
        elif topic in topics.transforms:
            for each in message.transforms:
                seconds = None if is_fixed(topic) else stamp(each) / 1e9
                tf.add(each.child_frame_id.lstrip("/"), frame_of(each), seconds, each.transform)
        else:
            is_odometry = bag.topics[topic] == ODOMETRY
            child = message.child_frame_id.lstrip("/") if is_odometry else None
            pose = message.pose.pose if is_odometry else message.pose
            poses.append((topic, child, frame_of(message), stamp(message) / 1e9, pose))
    for topic in images:
        if not moments[topic]:
            without = ", or map without colour (--topic.color none)" if topic == topics.color else ""
            raise DatasetError(f"{bag.path}: {topic} has lost its messages; copy the bag again{without}")
    others = {topic: Transforms(bag.path) for topic in topics.poses}
    for topic, child, parent, seconds, pose in poses:
        others[topic].add(frames[topics.depth] if child is None else child, parent, seconds, pose)
    depth = _named(moments[topics.depth], f"{bag.path}: {topics.depth}")
    colors = _nearest(depth, moments[topics.color]) if topics.color else {}
    return Index(depth, colors, frames, tf, others)


def read_camera(bag: Bag, topics: Topics, frames: dict[str, str]) -> Camera:
    """The camera of the info topic, which depth and colour must be registered to.

    Raises:
        DatasetError: they are of another frame than the camera.
    """
    info = next((message for _, _, message in bag.messages([topics.info])), None)
    if info is None:
        raise DatasetError(f"{bag.path}: {topics.info} has lost its messages; copy the bag again")
    for topic in (topics.depth, topics.color):
        if topic is not None and frame_of(info) and frames.get(topic, "") not in ("", frame_of(info)):
            raise DatasetError(
                f"{bag.path}: {topic} is of frame {frames[topic]}, its camera {topics.info} of {frame_of(info)}: one view "
                "is due; record depth that is registered to colour (as aligned_depth_to_color) and name it by "
                "--topic.depth and --topic.info, or map without colour (--topic.color none)"
            )
    rectified = "rect" in topics.depth
    if is_distorted(info) and not rectified:
        log.warning("%s: the lens distortion of %s is not corrected", bag.path, topics.info)
    origin = f"{bag.path}: {topics.info}"
    return Camera(origin, camera_matrix(info, rectified, origin), (info.width, info.height))


def _named(moments: list[Moment], origin: str) -> dict[str, Moment]:
    """By name: seconds and nine digits of nanoseconds."""
    found = {f"{m.stamp // 10**9}.{m.stamp % 10**9:09d}": m for m in sorted(moments, key=lambda m: m.stamp)}
    if len(found) < len(moments):
        if len(found) == 1:
            raise DatasetError(
                f"{origin}: all {len(moments)} headers have the same time: there is no telling where they were"
            )
        log.warning("%s: %d images share another's time and are left out", origin, len(moments) - len(found))
    return found


def _nearest(depth: dict[str, Moment], colors: list[Moment]) -> dict[str, Moment]:
    stamps = np.array([moment.stamp for moment in colors])
    found = {}
    for name, moment in depth.items():
        gaps = np.abs(stamps - moment.stamp)
        if gaps.min() <= MAX_DIFFERENCE * 1e9:
            found[name] = colors[int(gaps.argmin())]
    return found
