"""Pictures of the procedural families: `python -m objgraph.bench.pictures.contact_sheet --category car --out FILE`."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import trimesh
import tyro
from jaxtyping import Float
from PIL import Image

from objgraph.atomic import new_file
from objgraph.families import FAMILIES
from objgraph.geometry.frames import look_at
from objgraph.observation.frames import Intrinsics
from objgraph.show import raster

_OVERSAMPLING = 2
_DISTANCE = 4.0
"""From the eye to the object, in its diagonals: far enough that the picture is nearly parallel."""
_COLOR = np.array([0.60, 0.69, 0.83])
_UP = np.array([0.0, 1.0, 0.0])


@dataclass(frozen=True)
class SheetConfig:
    """Which meshes are drawn, and how large."""

    category: str
    """A category that has procedural families."""
    out: Path
    """The PNG to write."""
    columns: int = 8
    """Meshes of each family, one family a row."""
    cell: int = 140
    """Width and height of a mesh's picture in pixels."""
    azimuth: float = 35.0
    """Direction that the meshes are seen from, degrees about y from the front towards +x."""
    elevation: float = 25.0
    """Of the eye above the horizontal, degrees."""
    seed: int = 0


def draw_mesh(
    mesh: trimesh.Trimesh, cell: int, azimuth: float, elevation: float
) -> Float[np.ndarray, "c c 3"]:
    """A canonical mesh on white; angles in degrees."""
    a, e = np.radians([azimuth, elevation])
    eye = _DISTANCE * np.array([np.cos(e) * np.sin(a), np.sin(e), -np.cos(e) * np.cos(a)])
    size = cell * _OVERSAMPLING
    focal = _DISTANCE * size * 1.05
    intrinsics = Intrinsics(focal, focal, (size - 1) / 2, (size - 1) / 2, size, size)
    camera = raster.Camera(intrinsics, look_at(eye, np.zeros(3), _UP))
    colors = np.tile(_COLOR, (len(mesh.vertices), 1))
    layer = raster.draw_surfaces(
        camera, [raster.Surface(np.asarray(mesh.vertices), np.asarray(mesh.faces), colors)]
    )
    picture = np.where(np.isfinite(layer.depth)[..., None], layer.color, 1.0)
    return picture.reshape(cell, _OVERSAMPLING, cell, _OVERSAMPLING, 3).mean((1, 3))


def tiled(rows: Sequence[Sequence[Float[np.ndarray, "c c 3"]]]) -> Image.Image:
    """Rows of equally many pictures as one image, without the rows' blank margins."""
    strips = [np.concatenate(list(row), axis=1) for row in rows]
    sheet = np.concatenate([_trimmed(strip) for strip in strips], axis=0)
    return Image.fromarray((255 * sheet).round().astype(np.uint8))


def _trimmed(strip: Float[np.ndarray, "c w 3"], margin: int = 6) -> Float[np.ndarray, "h w 3"]:
    drawn = np.flatnonzero((strip < 1).any((1, 2)))
    return np.pad(strip[drawn[0] : drawn[-1] + 1], [(margin, margin), (0, 0), (0, 0)], constant_values=1.0)


def contact_sheet(config: SheetConfig) -> None:
    """Write a picture with a row of meshes for each family of a category."""
    rows = []
    for i, family in enumerate(FAMILIES[config.category].values()):
        meshes = [family(np.random.default_rng([config.seed, i, j])) for j in range(config.columns)]
        rows.append([draw_mesh(mesh, config.cell, config.azimuth, config.elevation) for mesh in meshes])
    _write(config.out, tiled(rows))


def _write(path: Path, image: Image.Image) -> None:
    """In 64 colours: the meshes have one."""
    with new_file(path) as unfinished:
        image.quantize(64, dither=Image.Dither.NONE).save(unfinished, format="PNG", optimize=True)


if __name__ == "__main__":
    contact_sheet(tyro.cli(SheetConfig))
