"""Ray-cast depth, instance and colour images of a room."""

from dataclasses import dataclass

import numpy as np
import open3d as o3d
import trimesh
from jaxtyping import Float, Int, UInt8
from matplotlib.colors import hsv_to_rgb

from objgraph.synthetic.scene import PlacedFurniture

_LAMP = np.array([0.6, -0.9, 2.3])
_BACKGROUND = np.array([[0.55, 0.45, 0.36], [0.82, 0.81, 0.78]])  # floor, walls


@dataclass(frozen=True)
class Rendering:
    """One view, free of noise."""

    depth: Float[np.ndarray, "h w"]
    """z-depth in metres, 0 where nothing is hit."""
    incidence: Float[np.ndarray, "h w"]
    """Angle between the ray and the surface's normal, radians; pi/2 where nothing is hit."""
    instances: Int[np.ndarray, "h w"]
    """Index of the piece plus one; 0 for floor, walls and emptiness."""
    color: UInt8[np.ndarray, "h w 3"]
    """RGB; black of a renderer without colours."""


class Renderer:
    """Casts rays at the pieces and the shell (floor first, then walls) of one room."""

    def __init__(
        self,
        pieces: list[PlacedFurniture],
        shell: list[trimesh.Trimesh],
        rng: np.random.Generator,
        colored: bool = True,
    ) -> None:
        self._colored = colored
        self._scene = o3d.t.geometry.RaycastingScene()
        meshes = [(piece.p_world, piece.piece.mesh.faces) for piece in pieces]
        meshes += [(part.vertices, part.faces) for part in shell]
        for vertices, faces in meshes:
            self._scene.add_triangles(_tensor(vertices), o3d.core.Tensor(np.asarray(faces, dtype=np.uint32)))
        self._pieces = len(pieces)
        walls = np.repeat(_BACKGROUND[1:], max(len(shell) - 1, 0), axis=0)
        # hues spread evenly, so that no two pieces look alike
        hue = (rng.random() + np.arange(len(pieces)) / max(len(pieces), 1)) % 1
        tones = rng.uniform([0.3, 0.4], [0.6, 0.75], size=(len(pieces), 2))
        coats = hsv_to_rgb(np.column_stack([hue, tones]))
        self._albedo = np.concatenate([coats, _BACKGROUND[:1], walls])

    def render(
        self,
        camera: Float[np.ndarray, "3 3"],
        T_world_camera: Float[np.ndarray, "4 4"],
        width: int,
        height: int,
    ) -> Rendering:
        """One image of the pinhole `camera`, OpenCV axes, pixel centres at integer coordinates."""
        u, v = np.meshgrid(np.arange(width), np.arange(height))
        d_camera = np.stack([u, v, np.ones_like(u)], axis=-1) @ np.linalg.inv(camera).T
        # z = 1 in the camera frame, so the ray's parameter is z-depth
        d_world = d_camera @ T_world_camera[:3, :3].T
        origin = np.broadcast_to(T_world_camera[:3, 3], d_world.shape)
        cast = self._scene.cast_rays(_tensor(np.concatenate([origin, d_world], axis=-1)))
        depth = cast["t_hit"].numpy().astype(float)
        hit = np.isfinite(depth)
        depth[~hit] = 0.0
        normals = cast["primitive_normals"].numpy().astype(float)
        cosine = -(normals * d_world).sum(axis=-1) / np.linalg.norm(d_world, axis=-1)
        normals *= np.where(cosine < 0, -1.0, 1.0)[..., None]
        geometry = np.where(hit, cast["geometry_ids"].numpy().astype(np.int64), -1)
        p_world = origin + depth[..., None] * d_world
        return Rendering(
            depth=depth,
            incidence=np.where(hit, np.arccos(np.clip(np.abs(cosine), 0, 1)), np.pi / 2),
            instances=np.where((geometry >= 0) & (geometry < self._pieces), geometry + 1, 0),
            color=self._shade(p_world, normals, np.abs(cosine), geometry),
        )

    def _shade(
        self, p_world: np.ndarray, normals: np.ndarray, cosine: np.ndarray, geometry: np.ndarray
    ) -> UInt8[np.ndarray, "h w 3"]:
        """One lamp with hard shadows, and a light at the camera."""
        if not self._colored:
            return np.zeros(p_world.shape, np.uint8)
        albedo = self._albedo[geometry]
        planks = np.floor(p_world[..., 0] / 0.18).astype(int) % 2
        albedo = np.where(
            (geometry == self._pieces)[..., None], albedo * (1 - 0.08 * planks[..., None]), albedo
        )
        to_lamp = _LAMP - p_world
        lambert = np.clip((normals * to_lamp).sum(axis=-1) / np.linalg.norm(to_lamp, axis=-1), 0, 1)
        start = p_world + 2e-3 * normals
        shadow = self._scene.test_occlusions(
            _tensor(np.concatenate([start, _LAMP - start], axis=-1)), tnear=0.0, tfar=1.0
        ).numpy()
        light = 0.25 + 0.35 * cosine + 0.5 * lambert * ~shadow
        image = np.where((geometry >= 0)[..., None], albedo * light[..., None], 0.0)
        return (255 * np.clip(image, 0, 1) ** (1 / 1.6)).astype(np.uint8)


def _tensor(array: np.ndarray) -> o3d.core.Tensor:
    return o3d.core.Tensor(np.ascontiguousarray(array, dtype=np.float32))
