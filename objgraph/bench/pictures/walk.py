"""A picture of straight walks between the codes of shapes that no training saw: `python -m objgraph.bench.pictures.walk`."""

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
from objgraph.families import draw
from objgraph.priors.mesh import extract_mesh
from objgraph.priors.registry import load_prior
from objgraph.priors.shape_prior import ShapePrior
from objgraph.show import figure
from objgraph.synthetic.furniture import FAMILIES, make_furniture
from objgraph.training.code_search import sample_rows, search
from objgraph.training.samples import SampleConfig, sample_solid
from objgraph.training.solid import Solid
from objgraph.training.stretch import multiplied, to_decoder

_UNSEEN_SEED = 1_000_003
"""Added to the seed of procedural shapes where there is no synthetic furniture: training draws with other seeds."""


@dataclass(frozen=True)
class WalkConfig:
    """Walks between shapes that no training saw: the synthetic furniture, or procedural shapes of another seed."""

    category: str
    """Category of the prior."""
    out: Path
    """The PNG to write."""
    prior: Path | None = None
    """The prior's .safetensors file; by default the category's shipped one."""
    pairs: int = 4
    """Walks, one a row; each starts where the one before ends."""
    steps: int = 7
    """Shapes of a walk, both ends included."""
    resolution: int = 96
    """Cells an axis of the marching cubes."""
    cell: int = 150
    """Width and height of a shape's picture in pixels."""
    azimuth: float = 35.0
    """Direction that the shapes are seen from, degrees about y from the front towards +x."""
    elevation: float = 25.0
    """Of the eye above the horizontal, degrees."""
    seed: int = 0
    """Of the shapes' dimensions."""


@dataclass(frozen=True)
class End:
    """An end of a walk."""

    name: str
    code: Float[np.ndarray, "l"]
    """The best code of the shape, given signed distances everywhere."""
    stretch: Float[np.ndarray, "3"]
    """That of the shape's box; see `objgraph.training.stretch`."""


def walk_picture(config: WalkConfig) -> None:
    """Fit the ends, mesh the shapes on the straight lines between their codes, and draw them.

    Raises:
        PriorError: there is no such prior, or no shapes of its category.
        SolveError: a code on the way has no surface.
    """
    prior = load_prior(config.prior or config.category)
    ends = [fitted(prior, name, mesh) for name, mesh in unseen_shapes(prior.category, config)]
    rows = [
        [
            draw_mesh(mesh, config.cell, config.azimuth, config.elevation)
            for mesh in walk(prior, first, last, config.steps, config.resolution)
        ]
        for first, last in pairwise(ends)
    ]
    names = [(first.name, last.name) for first, last in pairwise(ends)]
    _write(rows, names, config)


def unseen_shapes(category: str, config: WalkConfig) -> list[tuple[str, trimesh.Trimesh]]:
    """The canonical meshes between which the walks go, closed parts each, by the names of their families."""
    count = config.pairs + 1
    if category not in FAMILIES:
        drawn = draw(category, count, config.seed + _UNSEEN_SEED)
        return [(name.split("/")[-1], mesh) for name, mesh in drawn]
    families = FAMILIES[category]
    chosen = [families[i % len(families)] for i in range(count)]
    furniture = [
        make_furniture(
            "chair" if category == "chair" else "table", family, np.random.default_rng([config.seed, i])
        )
        for i, family in enumerate(chosen)
    ]
    return [(piece.family, piece.mesh) for piece in furniture]


def fitted(prior: ShapePrior, name: str, mesh: trimesh.Trimesh) -> End:
    """The end of a walk that is most like a canonical mesh of closed parts."""
    solid = Solid(name, tuple(mesh.split(only_watertight=False)))
    stretch = to_decoder(prior, np.asarray(mesh.extents))
    samples = sample_solid(solid, SampleConfig(count=4000), seed=0)
    return End(name, search(prior, sample_rows(samples, stretch)).codes[0], stretch)


def walk(prior: ShapePrior, first: End, last: End, steps: int, resolution: int) -> list[trimesh.Trimesh]:
    """Meshes, in the canonical frame, at equal steps from one code to another."""

    def at(t: float) -> trimesh.Trimesh:
        mesh = extract_mesh(prior.decoder, (1 - t) * first.code + t * last.code, resolution)
        return multiplied(mesh, (1 - t) * first.stretch + t * last.stretch)

    return [at(t) for t in np.linspace(0, 1, steps)]


def _write(
    rows: Sequence[Sequence[Float[np.ndarray, "c c 3"]]],
    names: Sequence[tuple[str, str]],
    config: WalkConfig,
) -> None:
    """One walk a row, the names of its ends beneath them."""
    sheet = Figure(
        figsize=(config.steps * config.cell / 100, len(rows) * (config.cell + 18) / 100),
        dpi=100,
        facecolor="white",
    )
    axes = sheet.subplots(len(rows), config.steps, squeeze=False)
    sheet.subplots_adjust(left=0, right=1, bottom=0.04, top=1, wspace=0, hspace=0.14)
    for row, line, (first, last) in zip(rows, axes, names, strict=True):
        for picture, axis in zip(row, line, strict=True):
            axis.imshow(picture, interpolation="none")
            axis.axis("off")
        for axis, name in ((line[0], first), (line[-1], last)):
            axis.set_title(name.replace("_", " "), fontsize=8, color="0.35", y=-0.11, va="top")
    figure.finish(sheet, None, None, config.out)


if __name__ == "__main__":
    walk_picture(tyro.cli(WalkConfig))
