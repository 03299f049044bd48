"""Messages of a ROS 1 bag, a ROS 2 bag or an MCAP file, without ROS: the package rosbags reads them (extra `bag`)."""

import weakref
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from objgraph.errors import DatasetError

_INSTALL = "install it with: pip install 'objgraph[bag]'"
_FILES = (".bag", ".mcap", ".db3")


@dataclass(frozen=True)
class Moment:
    """When a message was made, and where it lies in the bag."""

    stamp: int
    """Of its header, nanoseconds."""
    logged: int
    """When it was recorded, nanoseconds."""


class Bag:
    """An open bag; messages are read on demand, and it closes with the last reference to it."""

    def __init__(self, path: Path) -> None:
        """Raises DatasetError: rosbags is not installed, or the file is missing or damaged."""
        try:
            from rosbags.highlevel import AnyReader
            from rosbags.typesys import Stores, get_typestore
        except ImportError as error:
            raise DatasetError(f"{path}: a bag needs rosbags, which is not here; {_INSTALL}") from error
        self.path = path
        with _reading(path):
            # older ROS 2 bags do not say how their messages are laid out
            reader = AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE))
            reader.open()
        weakref.finalize(self, reader.close)
        self._reader = reader
        self.topics: dict[str, str] = {c.topic: c.msgtype for c in reader.connections if c.msgcount}
        """Type by name, as `sensor_msgs/msg/Image`, of topics that have messages."""
        if not all(isinstance(word, str) for pair in self.topics.items() for word in pair):
            raise DatasetError(f"{path}: a topic has no name or no type; copy the bag again")

    def messages(
        self, topics: Collection[str], start: int | None = None, stop: int | None = None
    ) -> Iterator[tuple[str, int, Any]]:
        """Topic, time of recording and content of messages recorded in a span, nanoseconds.

        Raises:
            DatasetError: the bag is damaged.
        """
        connections = [c for c in self._reader.connections if c.topic in topics]
        with _reading(self.path):
            for connection, logged, data in self._reader.messages(connections, start, stop):
                yield connection.topic, logged, self._reader.deserialize(data, connection.msgtype)

    def message(self, topic: str, moment: Moment) -> Any:
        """One message; raises DatasetError where it cannot be read."""
        for _, _, message in self.messages([topic], moment.logged, moment.logged + 1):
            if stamp(message) == moment.stamp:
                return message
        raise DatasetError(
            f"{self.path}: {topic} has lost its message at {moment.stamp} ns; copy the bag again"
        )


def stamp(message: Any) -> int:
    """When a message was made, nanoseconds."""
    return message.header.stamp.sec * 10**9 + message.header.stamp.nanosec


def frame_of(message: Any) -> str:
    """The coordinate frame of a message; ROS 1 once wrote a slash before it."""
    return message.header.frame_id.lstrip("/")


def bags(root: Path) -> dict[str, Path]:
    """The bags at `root` by name: itself, else those right in it, else the one of each folder in it.

    Raises:
        DatasetError: there is no such file or folder.
    """
    if not root.exists():
        raise DatasetError(f"{root}: no such file or folder")
    if _is_bag(root):
        return {root.resolve().name: root}
    if root.is_file():
        raise DatasetError(
            f"{root}: no bag; there are {', '.join(_FILES)} files and folders with metadata.yaml"
        )
    if here := _bags_in(root):
        return {path.name: path for path in here}
    below = {folder.name: _bags_in(folder) for folder in sorted(root.iterdir()) if folder.is_dir()}
    return {name: found[0] for name, found in below.items() if len(found) == 1}


def _bags_in(folder: Path) -> list[Path]:
    return sorted(path for path in folder.iterdir() if _is_bag(path))


def _is_bag(path: Path) -> bool:
    return path.suffix in _FILES if path.is_file() else (path / "metadata.yaml").is_file()


@contextmanager
def _reading(path: Path) -> Iterator[None]:
    try:
        yield
    except DatasetError:
        raise
    except Exception as error:  # rosbags' parsers stumble over damage in many ways
        reason = str(error).strip() or type(error).__name__
        raise DatasetError(
            f"{path}: no readable bag ({reason}); copy it again, or mend it with `rosbag reindex`, `ros2 bag reindex` "
            "or `mcap recover`"
        ) from error
