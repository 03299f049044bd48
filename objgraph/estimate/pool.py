"""Everything an object's views offer to sample from, in the world frame."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from factors.rays import BOX_HALF_SIZE, canonical_interval
from factors.state import ObjectState
from objgraph.observation.sampling import ObjectView


@dataclass(frozen=True)
class WorldRays:
    """Rays of several cameras; `factors.rays.Rays` says what depth, hit and end mean."""

    origin_world: Float[np.ndarray, "r 3"]
    direction_world: Float[np.ndarray, "r 3"]
    """One metre along the camera's z axis each, so that multiples are z-depths."""
    depth: Float[np.ndarray, "r"]
    hit: Bool[np.ndarray, "r"]
    end: Float[np.ndarray, "r"]
    sigma: Float[np.ndarray, "r"]
    axis_world: Float[np.ndarray, "r 3"]
    """The camera's z axis."""
    first_view: Bool[np.ndarray, "r"]
    """Whether the ray is of the first view."""

    def take(self, indices: np.ndarray) -> "WorldRays":
        """Some of the rays."""
        return WorldRays(*(array[indices] for array in vars(self).values()))

    def interval(
        self, state: ObjectState, half_box: float | Float[np.ndarray, "3"] = BOX_HALF_SIZE
    ) -> tuple[Float[np.ndarray, "r"], Float[np.ndarray, "r"]]:
        """z-depths at which the rays enter and leave the object's canonical box; near >= far where they miss it."""
        direction = self.direction_world @ state.T_world_object.rotation().matrix() / state.scale
        return canonical_interval(state.to_object(self.origin_world), direction, half_box)

    def depth_of_centre(self, state: ObjectState) -> Float[np.ndarray, "r"]:
        """z-depth of the object's origin in each ray's camera."""
        return ((state.T_world_object.translation() - self.origin_world) * self.axis_world).sum(axis=1)

    def at(self, depth: Float[np.ndarray, "r k"]) -> Float[np.ndarray, "r k 3"]:
        """World points at z-depths along the rays."""
        return self.origin_world[:, None] + depth[..., None] * self.direction_world[:, None]


@dataclass(frozen=True)
class Pool:
    """Surface points and rays of all views of one object."""

    p_world: Float[np.ndarray, "n 3"]
    rays: WorldRays
    half_box: float | Float[np.ndarray, "3"] = BOX_HALF_SIZE
    """Half the edges of the canonical box that rays are cut in."""

    @classmethod
    def of(
        cls, views: Sequence[ObjectView], half_box: float | Float[np.ndarray, "3"] = BOX_HALF_SIZE
    ) -> "Pool":
        """The pool of some views, each at its own camera."""
        parts = []
        for i, view in enumerate(views):
            R, rays = view.T_world_camera.rotation().matrix(), view.rays
            origin = np.broadcast_to(view.T_world_camera.translation(), rays.directions_camera.shape)
            axis = np.broadcast_to(R[:, 2], origin.shape)
            direction, first = rays.directions_camera @ R.T, np.full(len(origin), i == 0)
            world = (origin, direction, rays.depth, rays.hit, rays.end, rays.sigma, axis, first)
            parts.append(world)
        joined = WorldRays(*(np.concatenate(arrays) for arrays in zip(*parts, strict=True)))
        return cls(np.concatenate([view.points_world for view in views]), joined, half_box)

    def draw(self, rng: np.random.Generator, points: int, rays: int) -> "Pool":
        """At most so many of either, without repetition."""
        some = rng.permutation(len(self.p_world))[:points]
        few = rng.permutation(len(self.rays.depth))[:rays]
        return Pool(self.p_world[some], self.rays.take(few), self.half_box)
