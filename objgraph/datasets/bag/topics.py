"""Which topics of a bag hold depth, colour, the camera and its poses, by type and name."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

from objgraph.errors import DatasetError

IMAGES = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage")
INFO = "sensor_msgs/msg/CameraInfo"
TRANSFORMS = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
ODOMETRY, POSE = "nav_msgs/msg/Odometry", "geometry_msgs/msg/PoseStamped"
NONE = "none"
_REGISTERED = ("aligned_depth_to_color", "registered", "depth_to_rgb")


@dataclass(frozen=True)
class Topics:
    """The topics that are read."""

    depth: str
    color: str | None
    info: str
    transforms: tuple[str, ...]
    """Of type tf."""
    poses: tuple[str, ...]
    """Odometry and poses, of which one may count."""
    is_named: bool = False
    """Whether it was asked for, so that it counts before tf."""


def choose(
    topics: Mapping[str, str],
    origin: object,
    depth_topic: str | None = None,
    color_topic: str | None = None,
    info_topic: str | None = None,
    pose_topic: str | None = None,
) -> Topics:
    """The topics that are named, and for the others those that their types and names speak for.

    `topics` has types by name; the colour "none" is none.

    Raises:
        DatasetError: a topic is not there or of another type, or several would do; the message lists them.
    """
    color, info, pose = color_topic, info_topic, pose_topic
    depth = depth_topic or _best(
        "depth", (t for t in _of(topics, IMAGES) if "depth" in t.lower()), _depth_rank, topics, origin
    )
    if color is None:
        named = [t for t in _of(topics, IMAGES) if any(word in t.lower() for word in ("color", "rgb"))]
        others = [t for t in named if "depth" not in t.lower() and t != depth]
        if others:
            color = _best("color", others, lambda t: (-_shared(t, depth), *_image_rank(t)), topics, origin)
    elif color == NONE:
        color = None
    info = info or _best(
        "info",
        _of(topics, (INFO,)),
        lambda t: (t != _camera_of(depth), color is None or t != _camera_of(color)),
        topics,
        origin,
    )
    for kind, name, types in (("depth", depth, IMAGES), ("color", color, IMAGES), ("info", info, (INFO,))):
        if name is not None:
            _check(topics, kind, name, types, origin)
    transforms = _of(topics, TRANSFORMS)
    if pose is None:
        return Topics(depth, color, info, transforms, _of(topics, (ODOMETRY, POSE)))
    _check(topics, "pose", pose, (*TRANSFORMS, ODOMETRY, POSE), origin)
    if topics[pose] in TRANSFORMS:
        fixed = tuple(t for t in transforms if is_fixed(t) and t != pose)
        return Topics(depth, color, info, (pose, *fixed), ())
    return Topics(depth, color, info, transforms, (pose,), True)


def is_fixed(topic: str) -> bool:
    """Whether a tf topic is of transforms that never change."""
    return topic.endswith("tf_static")


def listed(topics: Mapping[str, str]) -> str:
    return ", ".join(f"{name} ({kind.rsplit('/', 1)[-1]})" for name, kind in sorted(topics.items())) or "none"


def _of(topics: Mapping[str, str], types: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(sorted(name for name, kind in topics.items() if kind in types))


def _best(
    kind: str,
    candidates: Iterable[str],
    rank: Callable[[str], tuple],
    topics: Mapping[str, str],
    origin: object,
) -> str:
    """The one of least rank."""
    ranks = {name: rank(name) for name in candidates}
    best = [name for name, value in ranks.items() if value == min(ranks.values())]
    if len(best) == 1:
        return best[0]
    found = f"{len(best)} topics may be its {kind}: {', '.join(best)}" if best else f"no topic of {kind}"
    there = "" if best else f"; it has {listed(topics)}"
    raise DatasetError(f"{origin}: {found}; name one by {kind}_topic (--topic.{kind}){there}")


def _check(topics: Mapping[str, str], kind: str, name: str, types: tuple[str, ...], origin: object) -> None:
    if topics.get(name) not in types:
        found = f"is of type {topics[name]}" if name in topics else "has no messages"
        raise DatasetError(
            f"{origin}: {name}, named as {kind}, {found}; {', '.join(types)} are read; it has {listed(topics)}"
        )


def _depth_rank(topic: str) -> tuple[bool, bool, bool]:
    return (not any(word in topic for word in _REGISTERED), *_image_rank(topic))


def _image_rank(topic: str) -> tuple[bool, bool]:
    """Rectified images first, and of an image and its compressed copy the image."""
    return "rect" not in topic, "compressed" in topic


def _shared(a: str, b: str) -> int:
    """How many first parts of their names two topics share: those of one camera share some."""
    pairs = list(zip(a.split("/"), b.split("/"), strict=False))
    return next((i for i, (x, y) in enumerate(pairs) if x != y), len(pairs))


def _camera_of(image: str) -> str:
    """Where ROS has the camera of an image topic: beside it."""
    parts = image.split("/")
    if parts[-1] in ("compressed", "compressedDepth"):
        parts.pop()
    return "/".join([*parts[:-1], "camera_info"])
