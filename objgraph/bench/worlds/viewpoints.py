"""Where a person holds the camera: three views of the target far apart and three close together."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
import open3d as o3d
from jaxtyping import Float
from numpy.random import Generator

from objgraph.bench.worlds.room import Room, draw_room
from objgraph.errors import DatasetError
from objgraph.geometry.frames import look_at
from objgraph.geometry.raycaster import Raycaster, raycaster
from objgraph.synthetic.camera import Pose, intrinsics
from objgraph.synthetic.furniture import Furniture

Spacing = Literal["wide", "close"]
VIEWS = 3
"""Views of a case."""
APART: dict[Spacing, tuple[float, float]] = {"wide": (40.0, 100.0), "close": (5.0, 15.0)}
"""Degrees about the target, seen from above, between any two views of a case."""
HEIGHT_M = (1.1, 1.7)
"""Of the camera above the floor."""
DISTANCE_M = (1.2, 3.0)
"""From the camera to the middle of the target's box."""
MIN_PIXELS = 2200
"""Of the target, unoccluded, in an image of 640x480: with room for what masks and depth then lose."""
MIN_INSIDE = 0.85
"""Share of the target's silhouette within the image."""
MIN_VISIBLE = 0.36
"""Share of the target's silhouette that is within the image and unoccluded."""

MIN_CLUTTER = 2
"""Things beside the target in every room."""

_STEP = 4
_ROOMS = 300
_TRIES = 20
_FROM_WALL_M = 0.15
_FROM_THINGS_M = 0.2


@dataclass(frozen=True)
class Scene:
    """A room and T_world_camera of the views of either spacing; the first view is the same in both."""

    room: Room
    cameras: dict[Spacing, tuple[Pose, ...]]


def draw_scene(piece: Furniture, rng: Generator) -> Scene:
    """Rooms and cameras, drawn again until every view shows enough of the piece.

    Raises `DatasetError` when none of many rooms does: the piece is too thin or too large to be seen.
    """
    for _ in range(_ROOMS):
        bearing = float(rng.uniform(-np.pi, np.pi))
        room = draw_room(piece, bearing, rng)
        if len(room.occupied) <= MIN_CLUTTER:
            continue
        scene = _Photographer(room, rng).shoot(bearing)
        if scene is not None:
            return scene
    raise DatasetError(
        f"{piece.family} {piece.category}: no camera in {_ROOMS} rooms sees enough of it; its mesh is too thin or "
        "empty: leave it out"
    )


class TargetView:
    """What a camera sees of a room's target, by casting a ray at every fourth pixel in and about the image."""

    def __init__(self, room: Room) -> None:
        self._alone, self._all = raycaster(room.meshes[:1]), raycaster(room.meshes)
        camera = intrinsics()
        w, h = camera.width, camera.height
        u, v = np.meshgrid(np.arange(-w // 2, w + w // 2, _STEP), np.arange(-h // 2, h + h // 2, _STEP))
        self._directions = camera.backproject(u, v)
        self._inside = (u >= 0) & (u < w) & (v >= 0) & (v < h)
        self._area = _STEP**2 * 640 * 480 / (w * h)

    def measure(self, T_world_camera: Pose) -> tuple[float, float, float]:
        """Unoccluded pixels at 640x480, and the shares of the silhouette inside and inside and unoccluded."""
        alone, first = (
            _depths(scene, T_world_camera, self._directions) for scene in (self._alone, self._all)
        )
        silhouette = np.isfinite(alone)
        inside = silhouette & self._inside
        seen = inside & (first > alone - 1e-3)
        whole = max(int(silhouette.sum()), 1)
        return float(seen.sum() * self._area), float(inside.sum() / whole), float(seen.sum() / whole)

    def good(self, T_world_camera: Pose) -> bool:
        """Whether such a view is a view of the benchmark."""
        pixels, inside, visible = self.measure(T_world_camera)
        return pixels >= MIN_PIXELS and inside >= MIN_INSIDE and visible >= MIN_VISIBLE


class _Photographer:
    """Draws cameras about one room's target."""

    def __init__(self, room: Room, rng: Generator) -> None:
        self.room, self.rng = room, rng
        self.view = TargetView(room)
        self.middle = room.target.T_world_object[:3, 3]

    def shoot(self, bearing: float) -> Scene | None:
        """All views, or None when one cannot be had."""
        rng = self.rng
        for _ in range(_TRIES):
            height, distance = rng.uniform(*HEIGHT_M), rng.uniform(*DISTANCE_M)
            first = self._camera(bearing, height, distance)
            if first is None:
                continue
            wide = self._others("wide", bearing, None)
            close = self._others("close", bearing, (height, distance)) if wide else None
            if wide and close:
                return Scene(self.room, {"wide": (first, *wide), "close": (first, *close)})
            return None
        return None

    def _others(
        self, spacing: Spacing, bearing: float, near: tuple[float, float] | None
    ) -> list[Pose] | None:
        """The later views; `near`: height and distance that they keep to, if any."""
        rng, (low, high) = self.rng, APART[spacing]
        offsets, poses = [0.0], []
        for _ in range(VIEWS * _TRIES):
            offset = float(rng.choice([-1, 1]) * rng.uniform(low, high))
            height, distance = rng.uniform(*HEIGHT_M), rng.uniform(*DISTANCE_M)
            if near is not None:
                height = float(np.clip(near[0] + rng.normal(0, 0.06), *HEIGHT_M))
                distance = float(np.clip(near[1] * (1 + rng.normal(0, 0.05)), *DISTANCE_M))
            if not all(low <= abs(offset - other) <= high for other in offsets):
                continue
            pose = self._camera(bearing + np.radians(offset), height, distance)
            if pose is not None:
                offsets.append(offset)
                poses.append(pose)
            if len(poses) == VIEWS - 1:
                return poses
        return None

    def _camera(self, bearing: float, height: float, distance: float) -> Pose | None:
        """A hand-held camera that looks at about the target's middle, or None where it cannot be or sees too little."""
        rng = self.rng
        aim, roll = self.middle + rng.normal(0, 0.08, 3), rng.normal(0, 0.03)
        level = np.sqrt(max(distance**2 - (height - self.middle[2]) ** 2, 0.0))
        eye = np.array(
            [self.middle[0] + level * np.cos(bearing), self.middle[1] + level * np.sin(bearing), height]
        )
        if not can_hold(self.room, eye[:2]):
            return None
        T = with_roll(look_at(eye, aim, np.array([0.0, 0.0, 1.0])), roll)
        return T if self.view.good(T) else None


def with_roll(T_world_camera: Pose, roll: float) -> Pose:
    """A camera turned about where it looks, radians."""
    turned, c, s = T_world_camera.copy(), np.cos(roll), np.sin(roll)
    turned[:3, :3] = turned[:3, :3] @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    return turned


def can_hold(room: Room, at: Float[np.ndarray, "2"]) -> bool:
    """Whether a person can hold a camera above this place of the floor: in the room and over no furniture."""
    in_room = np.all(np.abs(at) <= np.array(room.size_m) / 2 - _FROM_WALL_M)
    return bool(in_room) and not any(_within(at, corners) for corners in room.occupied)


def _within(at: Float[np.ndarray, "2"], corners: Float[np.ndarray, "4 2"]) -> bool:
    """Whether a point lies in a rectangle or closer to it than a person stands."""
    away = at - corners.mean(axis=0)
    edges = np.stack([corners[1] - corners[0], corners[3] - corners[0]])
    lengths = np.linalg.norm(edges, axis=1)
    return bool(np.all(np.abs(edges @ away / lengths) <= lengths / 2 + _FROM_THINGS_M))


def _depths(
    scene: Raycaster, T_world_camera: Pose, directions: Float[np.ndarray, "h w 3"]
) -> Float[np.ndarray, "h w"]:
    rays = directions @ T_world_camera[:3, :3].T
    eye = np.broadcast_to(T_world_camera[:3, 3], rays.shape)
    cast = scene.cast_rays(o3d.core.Tensor(np.concatenate([eye, rays], axis=-1).astype(np.float32)))
    return cast["t_hit"].numpy().astype(float)
