"""Whether every code that the prior holds for likely is a shape: has a surface, in one piece, as large as the box."""

from dataclasses import dataclass
from functools import partial

import numpy as np
from jaxtyping import Float

from objgraph.errors import EvaluationError, SolveError
from objgraph.priors.mesh import extract_mesh
from objgraph.priors.shape_prior import ShapePrior
from objgraph.training.meshes.joined import WHOLE, pieces
from objgraph.work import in_order, process_pool

BOX_TOLERANCE = 0.03
"""Of an edge of the box, by which the shape of a code that fills it may differ."""


@dataclass(frozen=True)
class RandomCodes:
    """What came of random codes."""

    count: int
    failed: int
    """Without a surface."""
    one_piece: float
    """Share whose largest piece has at least 98 % of the surface."""
    fills_box: float | None
    """Share whose extents are those of the prior's box to 3 %; None where it has none."""
    within: float
    """Standard deviations, along each axis of the codes' covariance, beyond which a coordinate is drawn again."""
    resolution: int
    """Cells an axis of the marching cubes."""
    seed: int


def check_random_codes(
    prior: ShapePrior,
    count: int = 1000,
    within: float = 2.0,
    resolution: int = 96,
    seed: int = 0,
    jobs: int = 1,
) -> RandomCodes:
    """Mesh random codes: which have a surface, are in one piece, and fill the prior's box."""
    codes = prior.draw_codes(count, np.random.default_rng(seed), within)
    looks = [partial(_look, prior, resolution, code) for code in codes]
    if jobs == 1:
        found = [look() for look in looks]
    else:
        with process_pool(jobs, EvaluationError) as pool:
            found = list(in_order(pool, looks))
    meshed = [each for each in found if each is not None]
    return RandomCodes(
        count,
        failed=count - len(meshed),
        one_piece=sum(whole for whole, _ in meshed) / max(count, 1),
        fills_box=None if prior.box is None else sum(fills for _, fills in meshed) / max(count, 1),
        within=within,
        resolution=resolution,
        seed=seed,
    )


def _look(prior: ShapePrior, resolution: int, code: Float[np.ndarray, "l"]) -> tuple[bool, bool] | None:
    """Whether a code's mesh is in one piece and fills the box; None where there is no mesh."""
    try:
        mesh = extract_mesh(prior.decoder, code, resolution, remove_floaters=False)
    except SolveError:
        return None
    fills = prior.box is not None and bool(np.abs(mesh.extents / prior.box - 1).max() <= BOX_TOLERANCE)
    return bool(pieces(mesh)[1].max() >= WHOLE), fills
