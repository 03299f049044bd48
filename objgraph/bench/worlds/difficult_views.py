"""Rooms and cameras for a scan with faults: how much of the object is seen, from how far, how far apart."""

from dataclasses import dataclass

import numpy as np
import open3d as o3d
import trimesh
from jaxtyping import Bool, Float
from numpy.random import Generator

from objgraph.bench.worlds.room import Room, draw_room
from objgraph.bench.worlds.viewpoints import (
    HEIGHT_M,
    VIEWS,
    Scene,
    TargetView,
    can_hold,
    with_roll,
)
from objgraph.errors import DatasetError
from objgraph.geometry.frames import look_at, transformed, transformed_back
from objgraph.geometry.raycaster import Raycaster, raycaster
from objgraph.synthetic.camera import Pose, intrinsics
from objgraph.synthetic.faults import Faults
from objgraph.synthetic.furniture import Furniture

MIN_PIXELS = 1200
"""Of the target, unoccluded, in an image of 640x480, in every view."""
_NEAR_ENOUGH = 0.04
"""Of the share of surface that is to be seen."""
_ROOMS = 30
_WALKS = 4
_TRIES = 12
_FROM_EDGE_M = 0.7
_SURFACE = 2000
_AROUND = 2
"""Subdivisions of the sphere from which the outer surface is told from the inner: 162 directions."""


@dataclass(frozen=True)
class OuterSurface:
    """Points of a room's target, uniform by area, that can be seen from some side."""

    p_world: Float[np.ndarray, "n 3"]
    everything: Raycaster
    """All that may hide them."""

    @classmethod
    def of(cls, room: Room, p_object: Float[np.ndarray, "n 3"]) -> "OuterSurface":
        """In a room, from `outer_points` of its target."""
        p_world = transformed(room.target.T_world_object, room.target.scale * p_object)
        return cls(p_world, raycaster(room.meshes))

    def seen(self, T_world_camera: Pose) -> Bool[np.ndarray, "n"]:
        """Which of the points a camera sees."""
        camera = intrinsics()
        p_camera = transformed_back(T_world_camera, self.p_world)
        z = np.maximum(p_camera[:, 2], 1e-6)
        u, v = camera.fx * p_camera[:, 0] / z + camera.cx, camera.fy * p_camera[:, 1] / z + camera.cy
        inside = (p_camera[:, 2] > 0) & (u >= 0) & (v >= 0) & (u < camera.width - 1) & (v < camera.height - 1)
        return inside & _seen_from(self.everything, T_world_camera[:3, 3], self.p_world)


def outer_points(piece: Furniture) -> Float[np.ndarray, "n 3"]:
    """Points of a piece's surface that can be seen from some side, canonical; parts may hide what lies within."""
    alone = raycaster([(piece.mesh.vertices, piece.mesh.faces)])
    points = np.asarray(trimesh.sample.sample_surface(piece.mesh, _SURFACE, seed=0)[0])
    outer = np.zeros(len(points), dtype=bool)
    for direction in trimesh.creation.icosphere(_AROUND).vertices:
        outer |= _seen_from(alone, 5.0 * direction, points)
    return points[outer]


def visible_shares(room: Room, cameras: tuple[Pose, ...]) -> list[float]:
    """Of the target's outer surface, what the first camera, the first two, ... see."""
    surface = OuterSurface.of(room, outer_points(room.target.piece))
    seen = np.logical_or.accumulate([surface.seen(camera) for camera in cameras])
    return [float(part.mean()) for part in seen]


def draw_difficult_scene(piece: Furniture, faults: Faults, rng: Generator) -> Scene:
    """The first of many rooms and walks that show as much of the piece as `faults` say, or the one that does most nearly.

    Raises `DatasetError` when none shows it at all.
    """
    best: tuple[float, Scene] | None = None
    outer = outer_points(piece)
    for _ in range(_ROOMS if len(outer) else 0):
        bearing = float(rng.uniform(-np.pi, np.pi))
        room = draw_room(piece, bearing, rng, faults)
        view, surface = TargetView(room), OuterSurface.of(room, outer)
        for _ in range(_WALKS):
            cameras = _walk(room, view, bearing, faults, rng)
            if cameras is None:
                continue
            seen = np.any([surface.seen(camera) for camera in cameras], axis=0).mean()
            off = abs(float(seen) - faults.visible)
            if best is None or off < best[0]:
                best = off, Scene(room, {"wide": cameras})
            if off <= _NEAR_ENOUGH:
                return best[1]
    if best is None:
        raise DatasetError(
            f"{piece.family} {piece.category}: no camera in {_ROOMS} rooms sees enough of it; its mesh is too thin or "
            "empty: leave it out"
        )
    return best[1]


def _walk(
    room: Room, view: TargetView, bearing: float, faults: Faults, rng: Generator
) -> tuple[Pose, ...] | None:
    """All views one after another, or None where one cannot be had."""
    middle = room.target.T_world_object[:3, 3]
    side = float(rng.choice([-1.0, 1.0]))
    height = rng.uniform(*HEIGHT_M)
    bearing += rng.normal(0, 0.3)
    level = np.sqrt(max(faults.distance_m**2 - (height - middle[2]) ** 2, 0.0))
    # before a large table, or a desk, a person stands farther from its middle
    corners = room.occupied[0] - middle[:2]
    level = max(level, float((corners @ [np.cos(bearing), np.sin(bearing)]).max()) + _FROM_EDGE_M)
    # where the hand wants to look stays much the same from view to view
    aim = middle + rng.normal(0, faults.aim_m, 3) * [1, 1, 0.5]
    poses: list[Pose] = []
    for k in range(VIEWS):
        for _ in range(_TRIES):
            if faults.walk:
                sideways = side * k * faults.walk_m
                eye = [
                    level * np.cos(bearing) - sideways * np.sin(bearing),
                    level * np.sin(bearing) + sideways * np.cos(bearing),
                ]
            else:
                angle = bearing + side * k * np.radians(faults.apart_deg)
                eye = [level * np.cos(angle), level * np.sin(angle)]
            at = np.array([*(middle[:2] + eye), height]) + rng.normal(0, 0.03, 3)
            if not can_hold(room, at[:2]):
                return None
            pose = with_roll(
                look_at(at, aim + rng.normal(0, 0.05, 3), np.array([0.0, 0.0, 1.0])), rng.normal(0, 0.03)
            )
            if view.measure(pose)[0] >= MIN_PIXELS:
                poses.append(pose)
                break
        else:
            return None
    return tuple(poses)


def _seen_from(
    scene: Raycaster, eye: Float[np.ndarray, "3"], points: Float[np.ndarray, "n 3"]
) -> Bool[np.ndarray, "n"]:
    """Whether nothing lies between the eye and the points."""
    away = points - eye
    rays = np.concatenate([np.broadcast_to(eye, away.shape), away], axis=1).astype(np.float32)
    hit = scene.cast_rays(o3d.core.Tensor(rays))["t_hit"].numpy()
    # the ray's parameter is 1 at the point
    return hit * np.linalg.norm(away, axis=1) > np.linalg.norm(away, axis=1) - 5e-3
