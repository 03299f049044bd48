"""Rays cast at some meshes."""

from collections.abc import Iterable
from typing import TypeAlias

import numpy as np
import open3d as o3d

Raycaster: TypeAlias = o3d.t.geometry.RaycastingScene


def raycaster(meshes: Iterable[tuple[np.ndarray, np.ndarray]]) -> Raycaster:
    """Of vertices and faces; one thread, so that it may be used in many processes."""
    scene = Raycaster(nthreads=1)
    for vertices, faces in meshes:
        scene.add_triangles(np.asarray(vertices, np.float32), np.asarray(faces, np.uint32))
    return scene
