"""How well a shape prior describes meshes, given all of a surface and given one view of it."""

import logging
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from factors import checks
from objgraph.errors import ConfigError, ObjectGraphError
from objgraph.priors.mesh import RESOLUTIONS, mesh_of_grid, sdf_grid
from objgraph.priors.shape_prior import ShapePrior
from objgraph.training.codes.partial import PartialConfig, fit_view
from objgraph.training.codes.search import SearchConfig, sample_rows, search
from objgraph.training.codes.single_view import SingleViewConfig, take_view
from objgraph.training.codes.stretch import multiplied, to_decoder
from objgraph.training.meshes.folder import ChosenMeshes
from objgraph.training.meshes.samples import SampleConfig, sample_solid
from objgraph.training.meshes.solid import Solid
from objgraph.training.quality.true_shape import ShapeScore, TrueShape, read_solid, volume_iou
from objgraph.work import Workers, spread

log = logging.getLogger(__name__)

Progress = Callable[[int, int, "ShapeRow"], None]
"""Called with the meshes done, all meshes, and the one done last."""


@dataclass(frozen=True)
class PriorEvaluationConfig:
    """How a prior is evaluated."""

    resolution: int = 144
    """Cells an axis of the grid over [-bound, bound]^3, for marching cubes and the volumes alike."""
    bound: float = 0.55
    """Half the grid's edge, in the decoder's coordinates."""
    seed: int = 0
    """Of samples, views and measured points."""
    samples: SampleConfig = field(default_factory=lambda: SampleConfig(count=4000))
    """The signed distances that the full fit sees."""
    search: SearchConfig = field(default_factory=SearchConfig)
    """The full fit's search for a code."""
    partial: PartialConfig = field(default_factory=PartialConfig)
    """The fit to one view."""
    view: SingleViewConfig = field(default_factory=SingleViewConfig)
    """The one view."""

    def __post_init__(self) -> None:
        """Raises ConfigError where a number is not one of its kind."""
        checks.settings(self, ConfigError, resolution=RESOLUTIONS, bound=checks.POSITIVE)


@dataclass(frozen=True)
class ShapeRow:
    """One mesh. Lengths in diagonals of its box; None where nothing came out, which counts as infinitely bad."""

    mesh: str
    chamfer: float | None = None
    """Mean of the two directed mean distances from points on one surface to the other surface."""
    chamfer_points: float | None = None
    """The same between 20,000 points a side."""
    iou: float = 0.0
    """Intersection over union of the volumes."""
    recall: float = 0.0
    """Share of the true surface within 0.02 of the reconstruction."""
    precision: float = 0.0
    """Share of the reconstructed surface within 0.02 of the truth."""
    chamfer_partial: float | None = None
    """`chamfer` of the fit to one view."""
    iou_partial: float = 0.0
    """`iou` of the fit to one view."""
    recall_partial: float = 0.0
    """`recall` of the fit to one view."""
    partial_ratio: float | None = None
    """`chamfer_partial` over `chamfer`."""
    error: str | None = None
    """What failed."""


class _Measured(NamedTuple):
    score: ShapeScore
    iou: float


def evaluate_meshes(
    prior: ShapePrior,
    meshes: ChosenMeshes,
    config: PriorEvaluationConfig | None = None,
    jobs: int = 1,
    progress: Progress | None = None,
) -> list[ShapeRow]:
    """A row for every mesh, in the meshes' order; what cannot be evaluated says why.

    With more than one job, each runs on one thread of a process of its own.
    """
    config = config or PriorEvaluationConfig()
    rows: dict[str, ShapeRow] = {}
    for row in _rows(prior, meshes, config, jobs):
        rows[row.mesh] = row
        if row.error is not None:
            log.warning("%s is a failure: %s", row.mesh, row.error)
        if progress is not None:
            progress(len(rows), len(meshes.names), row)
    return [rows[name] for name in meshes.names]


def evaluate_mesh(prior: ShapePrior, path: Path, name: str, config: PriorEvaluationConfig) -> ShapeRow:
    """One mesh; whatever goes wrong with it becomes its row's error."""
    try:
        truth = TrueShape(read_solid(path, name), config.seed)
        stretch = to_decoder(prior, truth.extents)
        inside = truth.inside(config.resolution, config.bound, stretch)
        full = _measure(prior, truth, inside, stretch, full_code(prior, truth.solid, stretch, config), config)
    except Exception as error:  # a mesh that breaks anything is this mesh's failure and no other's
        log.debug("%s", name, exc_info=True)
        return ShapeRow(name, error=_words(error))
    row = ShapeRow(
        name,
        chamfer=full.score.chamfer,
        chamfer_points=full.score.chamfer_points,
        iou=full.iou,
        recall=full.score.recall,
        precision=full.score.precision,
    )
    try:
        view = take_view(truth.solid, config.seed, config.view)
        code = fit_view(prior, view, stretch, config.partial, config.seed)
        partial = _measure(prior, truth, inside, stretch, code, config)
    except Exception as error:
        log.debug("%s", name, exc_info=True)
        return replace(row, error=f"from one view: {_words(error)}")
    return replace(
        row,
        chamfer_partial=partial.score.chamfer,
        iou_partial=partial.iou,
        recall_partial=partial.score.recall,
        partial_ratio=partial.score.chamfer / full.score.chamfer if full.score.chamfer > 0 else None,
    )


def full_code(
    prior: ShapePrior, solid: Solid, stretch: Float[np.ndarray, "3"], config: PriorEvaluationConfig
) -> Float[np.ndarray, "l"]:
    """The best code of a solid of which signed distances are known everywhere."""
    samples = sample_solid(solid, config.samples, config.seed)
    return search(prior, sample_rows(samples, stretch), config.search, config.seed).codes[0]


def _measure(
    prior: ShapePrior,
    truth: TrueShape,
    inside: Bool[np.ndarray, "g g g"],
    stretch: Float[np.ndarray, "3"],
    code: Float[np.ndarray, "l"],
    config: PriorEvaluationConfig,
) -> _Measured:
    """A code's shape against the truth, with all its floaters."""
    # in stretched coordinates the distance changes faster
    slope = 1.5 * max(1.0, float(stretch.max()))
    grid = sdf_grid(prior.decoder, code, config.resolution, config.bound, slope=slope)
    mesh = mesh_of_grid(grid, config.bound, remove_floaters=False)
    return _Measured(truth.score(multiplied(mesh, stretch)), volume_iou(grid < 0, inside))


def _rows(
    prior: ShapePrior, meshes: ChosenMeshes, config: PriorEvaluationConfig, jobs: int
) -> Iterator[ShapeRow]:
    """The rows, in the order in which they are done."""
    works = [
        partial(evaluate_mesh, prior, path, name, config)
        for path, name in zip(meshes.paths, meshes.names, strict=True)
    ]
    for place, row in spread(works, Workers(jobs)):
        yield row if isinstance(row, ShapeRow) else ShapeRow(meshes.names[place], error=_words(row))


def _words(error: Exception) -> str:
    return str(error) if isinstance(error, ObjectGraphError) else f"{type(error).__name__}: {error}"
