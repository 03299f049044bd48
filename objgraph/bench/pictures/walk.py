"""A picture of shapes that priors hold for likely, and of those between them: `python -m objgraph.bench.pictures.walk`."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
import trimesh
import tyro
from jaxtyping import Float
from matplotlib.figure import Figure

from objgraph.bench.pictures.contact_sheet import draw_mesh
from objgraph.priors.mesh import extract_mesh
from objgraph.priors.registry import load_prior
from objgraph.priors.shape_prior import ShapePrior
from objgraph.show import figure


@dataclass(frozen=True)
class WalkConfig:
    """One prior a row: shapes of random codes, and between them those of codes on the straight lines."""

    out: Path
    """The PNG to write."""
    priors: tuple[str, ...]
    """Categories, or .safetensors files."""
    codes: int = 3
    """Random codes a row."""
    steps: int = 3
    """From each of them to the next."""
    resolution: int = 96
    """Cells an axis of the marching cubes."""
    cell: int = 150
    """Width and height of a shape's picture in pixels."""
    azimuth: float = 35.0
    """Direction that the shapes are seen from, degrees about y from the front towards +x."""
    elevation: float = 25.0
    """Of the eye above the horizontal, degrees."""
    seed: int = 0
    """Of the codes."""


def walk_picture(config: WalkConfig) -> None:
    """Draw random codes, mesh the shapes on the straight lines between them, floaters and all, and draw those.

    Raises:
        PriorError: there is no such prior.
        SolveError: a code on the way has no surface.
    """
    priors = [load_prior(name) for name in config.priors]
    rows = [
        [draw_mesh(mesh, config.cell, config.azimuth, config.elevation) for mesh in walk(prior, config)]
        for prior in priors
    ]
    _write(rows, [prior.category for prior in priors], config)


def walk(prior: ShapePrior, config: WalkConfig) -> list[trimesh.Trimesh]:
    """Meshes, in the decoder's frame, of random codes and at equal steps from each to the next."""
    codes = prior.draw_codes(config.codes, np.random.default_rng(config.seed))
    shares = np.arange(config.steps) / config.steps
    way = [(1 - t) * first + t * second for first, second in pairwise(codes) for t in shares]
    return [
        extract_mesh(prior.decoder, code, config.resolution, remove_floaters=False)
        for code in [*way, codes[-1]]
    ]


def _write(
    rows: Sequence[Sequence[Float[np.ndarray, "c c 3"]]], names: list[str], config: WalkConfig
) -> None:
    """One prior a row, its category at the left; a line under random codes."""
    columns = len(rows[0])
    sheet = Figure(
        figsize=(columns * config.cell / 100, len(rows) * config.cell / 100), dpi=100, facecolor="white"
    )
    axes = sheet.subplots(len(rows), columns, squeeze=False)
    sheet.subplots_adjust(left=0, right=1, bottom=0, top=1, wspace=0, hspace=0)
    for row, line, name in zip(rows, axes, names, strict=True):
        for i, (picture, axis) in enumerate(zip(row, line, strict=True)):
            axis.imshow(picture, interpolation="none")
            axis.axis("off")
            if i % config.steps == 0:
                axis.plot([0.3, 0.7], [0.03, 0.03], transform=axis.transAxes, color="0.6", linewidth=1)
        line[0].text(0.04, 0.95, name, transform=line[0].transAxes, fontsize=9, color="0.35", va="top")
    figure.finish(sheet, None, None, config.out)


if __name__ == "__main__":
    walk_picture(tyro.cli(WalkConfig))
