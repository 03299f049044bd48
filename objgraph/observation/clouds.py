"""What views say of one object as small clouds about its seen boxes, for a network."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy.random import Generator
from scipy.spatial import cKDTree

from objgraph.geometry.frames import transformed
from objgraph.observation.gravity_box import GravityBox, gravity_box
from objgraph.observation.sampling import ObjectView

FEATURES = 11
"""Of each point of a cloud: place and viewing direction in the box' frame, height over the box' floor, whether it is seen to be
free, and the surface's normal there, which a free point has none of."""
_NEIGHBOURS = 10
"""A normal is that of the plane through so many points."""


@dataclass(frozen=True)
class ViewCloud:
    """Points that one view sees, in the world."""

    surface: Float[np.ndarray, "n 3"]
    normals: Float[np.ndarray, "n 3"]
    """Of the surface, towards the camera."""
    free: Float[np.ndarray, "m 3"]
    """Seen to be empty: on the rays that pass the object, as deep as it is next to them."""
    eye: Float[np.ndarray, "3"]
    """Where the camera is."""


@dataclass(frozen=True)
class Clouds:
    """The same points about the upright box that holds those seen, at each of some headings."""

    points: Float[np.ndarray, "h p 11"]
    box: GravityBox


def view_cloud(view: ObjectView) -> ViewCloud:
    """Of a sampled view."""
    rays, T_world_camera = view.rays, view.T_world_camera.matrix()
    free = ~rays.hit & (rays.end > rays.depth)
    p_free = transformed(T_world_camera, rays.directions_camera[free] * rays.depth[free, None])
    surface, eye = view.points_world, T_world_camera[:3, 3]
    surface = surface[np.isfinite(surface).all(axis=1)]
    return ViewCloud(surface, normals(surface, eye), p_free, eye)


def normals(points: Float[np.ndarray, "n 3"], eye: Float[np.ndarray, "3"]) -> Float[np.ndarray, "n 3"]:
    """Of the surface that one camera sees points of, towards it: the direction in which each point's neighbours spread least."""
    if not len(points):
        return np.zeros((0, 3))
    _, near = cKDTree(points).query(points, min(_NEIGHBOURS, len(points)))
    about = points[near.reshape(len(points), -1)]
    about = about - about.mean(axis=1, keepdims=True)
    _, axes = np.linalg.eigh(np.swapaxes(about, 1, 2) @ about)
    least = axes[:, :, 0]
    away = ((eye - points) * least).sum(axis=1, keepdims=True)
    return np.where(away < 0, -least, least)


def clouds(
    views: Sequence[ViewCloud],
    up_world: Float[np.ndarray, "3"],
    floor: float | None,
    unit: float,
    headings: Float[np.ndarray, "h"],
    surface: int,
    free: int,
    rng: Generator,
) -> Clouds:
    """So many points on the surface and in free space, in the frame of the box at each heading and in `unit` metres.

    `floor` is its height along `up_world`, metres; an object near above it stands on it. Views must see at least 3 points.
    """
    p_surface = np.concatenate([view.surface for view in views])
    p_free = np.concatenate([view.free for view in views])
    n_surface = np.concatenate([view.normals for view in views])
    eyes = [np.concatenate([np.broadcast_to(v.eye, p.shape) for v, p in pairs]) for pairs in (
        [(view, view.surface) for view in views], [(view, view.free) for view in views]
    )]  # fmt: skip
    box = gravity_box(p_surface, up_world, headings, floor)
    parts = []
    kinds = (
        (p_surface, n_surface, eyes[0], surface, 0.0),
        (p_free, np.zeros_like(p_free), eyes[1], free, 1.0),
    )
    for points, normal, eye, count, is_free in kinds:
        if not len(points):  # nothing free is seen: what is seen is said again
            points, normal, eye, is_free = p_surface, n_surface, eyes[0], 0.0
        some = rng.choice(len(points), count, replace=len(points) < count)
        at = (points[some] - box.centre_world[:, None]) @ box.R_world_object / unit
        along = points[some] - eye[some]
        along = along / np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-9)
        height = at[..., 1:2] + box.size[:, None, 1:2] / (2 * unit)
        which = np.full((*height.shape[:2], 1), is_free)
        turned = along @ box.R_world_object, normal[some] @ box.R_world_object
        parts.append(np.concatenate([at, turned[0], height, which, turned[1]], axis=-1))
    return Clouds(np.concatenate(parts, axis=1).astype(np.float32), box)
