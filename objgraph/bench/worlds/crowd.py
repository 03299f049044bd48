"""Furniture that is pushed together, and things that lie on it."""

import numpy as np
import open3d as o3d
import trimesh
from jaxtyping import Float
from numpy.random import Generator

from objgraph.geometry.raycaster import Raycaster, raycaster
from objgraph.synthetic.furniture import Furniture
from objgraph.synthetic.scene import PlacedFurniture, stand

_CLEARANCE_M = 0.02
"""Between pieces that are pushed together."""
_STEP_M = 0.03
_LEVEL = 0.9
"""Cosine of the steepest surface on which a thing stays."""
_HEADROOM_M = 0.3


def pushed_against(target: PlacedFurniture, other: Furniture, rng: Generator) -> PlacedFurniture:
    """A piece before the target, moved towards its middle until the two all but touch: seats go under table tops.

    A chair faces the table.
    """
    chair_is_other = other.category == "chair"
    forward = target.T_world_object[:2, :3] @ [0.0, 0.0, -1.0]
    turn = rng.normal(0, 0.15) + (rng.integers(4) * np.pi / 2 if chair_is_other else 0.0)
    c, s = np.cos(turn), np.sin(turn)
    towards = np.array([[c, -s], [s, c]]) @ forward
    # at yaw 0 the front, -z, looks along world +y
    facing = -towards if chair_is_other else towards
    yaw = float(np.arctan2(-facing[0], facing[1])) + rng.normal(0, 0.1)
    scale = np.full(3, other.diagonal_m)
    aside = rng.normal(0, 0.08) * np.array([-towards[1], towards[0]])
    at = target.T_world_object[:2, 3] + aside
    surface = raycaster([(target.p_world, target.piece.mesh.faces)])
    probe = stand(other, scale, np.zeros(2), yaw)
    points = np.asarray(trimesh.sample.sample_surface(_mesh(probe), 3000, seed=0)[0])
    # the nearest place is no nearer than a share of the chair's depth under the table
    least = rng.uniform(0.0, 0.6) * 0.5 * float(target.scale[2] * target.piece.mesh.extents[2])
    for away in np.arange(least, 4.0, _STEP_M):
        moved = points + [*(at + away * towards), 0.0]
        if _clear(surface, moved):
            return stand(other, scale, at + away * towards, yaw)
    raise AssertionError("no piece is larger than four metres")


def things_on(target: PlacedFurniture, count: int, rng: Generator) -> list[trimesh.Trimesh]:
    """At most so many boxes and balls on the target's level surfaces."""
    mesh = _mesh(target)
    scene = raycaster([(mesh.vertices, mesh.faces)])
    sampled = trimesh.sample.sample_surface(mesh, 400, seed=int(rng.integers(1 << 31)))
    points = np.asarray(sampled[0])[np.asarray(mesh.face_normals)[sampled[1]][:, 2] > _LEVEL]
    up = np.tile([0.0, 0.0, 1.0], (len(points), 1))
    if len(points):
        rays = np.concatenate([points + 1e-3 * up, up], axis=1).astype(np.float32)
        points = points[scene.cast_rays(o3d.core.Tensor(rays))["t_hit"].numpy() > _HEADROOM_M]
    things = []
    for at in points[rng.permutation(len(points))[:count]]:
        things.append(_thing(rng))
        things[-1].apply_translation(at)
    return things


def _thing(rng: Generator) -> trimesh.Trimesh:
    """A book, a box, a bag; its bottom at the origin."""
    if rng.random() < 0.7:
        half, height = rng.uniform(0.04, 0.16, 2), rng.uniform(0.03, 0.3)
        thing = trimesh.creation.box(bounds=[[*-half, 0], [*half, height]])
        thing.apply_transform(trimesh.transformations.rotation_matrix(rng.uniform(0, np.pi), [0, 0, 1]))
        return thing
    radius = rng.uniform(0.05, 0.14)
    ball = trimesh.creation.icosphere(2, radius)
    ball.apply_translation([0, 0, 0.95 * radius])
    return ball


def _clear(surface: Raycaster, points: Float[np.ndarray, "n 3"]) -> bool:
    return bool(surface.compute_distance(points.astype(np.float32)).numpy().min() > _CLEARANCE_M)


def _mesh(placed: PlacedFurniture) -> trimesh.Trimesh:
    return trimesh.Trimesh(placed.p_world, placed.piece.mesh.faces, process=False)
