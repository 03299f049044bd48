"""Geometry of the map as what the viewer draws; all in the world frame, metres."""

from typing import NamedTuple

import numpy as np
import rerun as rr
import trimesh
from jaxtyping import Float, Int, UInt8
from scipy.spatial.transform import Rotation

from objgraph.geometry.boxes import OrientedBox
from objgraph.observation.frames import Intrinsics
from objgraph.show.placement import Ellipsoid

Rgb = tuple[int, int, int]

ELLIPSOID: Rgb = (213, 94, 0)


class Surface(NamedTuple):
    """A mesh in the world frame."""

    vertices: Float[np.ndarray, "v 3"]
    faces: Int[np.ndarray, "f 3"]


def box_shape(box: OrientedBox, label: str, rgb: Rgb) -> rr.Boxes3D:
    """Its edges, with a label."""
    return rr.Boxes3D(
        half_sizes=[box.extents / 2], centers=[box.centre], quaternions=[_quaternion(box.rotation)],
        colors=[rgb], labels=[label], fill_mode=rr.components.FillMode.MajorWireframe,
    )  # fmt: skip


def ellipsoid_shape(ellipsoid: Ellipsoid, rgb: Rgb) -> rr.Ellipsoids3D:
    """Solid, so that it is seen where it is small."""
    return rr.Ellipsoids3D(
        half_sizes=[ellipsoid.half_sizes], centers=[ellipsoid.centre],
        quaternions=[_quaternion(ellipsoid.rotation)], colors=[rgb], fill_mode=rr.components.FillMode.Solid,
    )  # fmt: skip


def mesh_shape(
    vertices: Float[np.ndarray, "v 3"],
    faces: Int[np.ndarray, "f 3"],
    colors: UInt8[np.ndarray, "v 3"] | None,
    albedo: tuple[int, ...] | None = None,
) -> rr.Mesh3D:
    """A surface with smooth normals, coloured by vertex or, by `albedo` (RGB or RGBA), as a whole."""
    normals = trimesh.Trimesh(vertices, faces, process=False).vertex_normals
    return rr.Mesh3D(
        vertex_positions=vertices, triangle_indices=faces, vertex_normals=normals, vertex_colors=colors,
        albedo_factor=albedo,
    )  # fmt: skip


def camera_pose(T_world_camera: Float[np.ndarray, "4 4"]) -> rr.Transform3D:
    """Camera to world."""
    return rr.Transform3D(translation=T_world_camera[:3, 3], mat3x3=T_world_camera[:3, :3])


def path_line(positions_world: Float[np.ndarray, "n 3"]) -> rr.LineStrips3D:
    """Where a camera went."""
    return rr.LineStrips3D([positions_world], colors=[(150, 150, 150)], radii=rr.Radius.ui_points(1.0))


def pinhole(intrinsics: Intrinsics) -> rr.Pinhole:
    """The viewer has a pixel's corner, not its centre, at integers."""
    return rr.Pinhole(
        focal_length=[intrinsics.fx, intrinsics.fy],
        principal_point=[intrinsics.cx + 0.5, intrinsics.cy + 0.5],
        resolution=[intrinsics.width, intrinsics.height],
        camera_xyz=rr.ViewCoordinates.RDF,
        image_plane_distance=0.3,
    )


def world_axes(up_world: Float[np.ndarray, "3"]) -> rr.ViewCoordinates:
    """The viewer knows worlds whose up is an axis: the one that is nearest to up."""
    axis = int(np.argmax(np.abs(up_world)))
    name = f"RIGHT_HAND_{'XYZ'[axis]}_{'UP' if up_world[axis] > 0 else 'DOWN'}"
    return getattr(rr.ViewCoordinates, name)


def _quaternion(rotation: Float[np.ndarray, "3 3"]) -> rr.Quaternion:
    return rr.Quaternion(xyzw=Rotation.from_matrix(rotation).as_quat())
