"""The code of a shape of which one depth view, its pose and its scale are known."""

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from factors import checks
from objgraph.errors import ConfigError
from objgraph.priors.shape_prior import ShapePrior
from objgraph.training.codes.search import CodeRows, SearchConfig, search
from objgraph.training.codes.single_view import DepthView, free_points


@dataclass(frozen=True)
class PartialConfig:
    """How a code is fitted to one view. Lengths in canonical units."""

    surface_points: int = 800
    """Seen surface points used."""
    free_points: int = 1600
    """Points in seen-empty space used."""
    surface_sigma: float = 0.01
    """Standard deviation of the decoder's value on the surface."""
    free_sigma: float = 0.01
    """The same of its violation of a lower bound."""
    truncation: float = 0.05
    """Lower bounds of the distance are no greater."""
    surface_effective: float = 1000.0
    """How many independent measurements the surface points count for, against the code's prior."""
    free_effective: float = 2000.0
    """How many independent measurements the points in empty space count for."""
    search: SearchConfig = field(default_factory=lambda: SearchConfig(first_points=600, kept=3))
    """How the code is searched for."""

    def __post_init__(self) -> None:
        """Raises ConfigError where a number is not one of its kind."""
        checks.settings(
            self, ConfigError, surface_points=checks.Range(1), free_points=checks.Range(1), surface_sigma=checks.POSITIVE,
            free_sigma=checks.POSITIVE,
        )  # fmt: skip


def fit_view(
    prior: ShapePrior,
    view: DepthView,
    stretch: Float[np.ndarray, "3"] | None = None,
    config: PartialConfig | None = None,
    seed: int = 0,
) -> Float[np.ndarray, "l"]:
    """The most probable code of what a view shows: the seen surface is at distance zero, seen-empty space outside.

    `stretch` is that of `objgraph.training.codes.stretch.to_decoder`; without it the decoder takes canonical points.
    """
    config = config or PartialConfig()
    stretch = np.ones(3) if stretch is None else stretch
    rows = view_rows(view, stretch, config, np.random.default_rng(seed))
    return search(prior, rows, config.search, seed).codes[0]


def view_rows(
    view: DepthView, stretch: Float[np.ndarray, "3"], config: PartialConfig, rng: np.random.Generator
) -> CodeRows:
    """What a view says of the decoder's values."""
    seen = view.seen
    seen = seen[rng.choice(len(seen), min(config.surface_points, len(seen)), replace=False)]
    empty, bound = free_points(view, config.free_points, config.truncation, rng)
    surface = CodeRows(
        seen / stretch,
        np.zeros(len(seen)),
        np.full(len(seen), config.surface_sigma),
        np.full(len(seen), config.surface_effective / len(seen)),
        np.zeros(len(seen), bool),
    )
    free = CodeRows(
        empty / stretch,
        bound,
        np.full(len(empty), config.free_sigma),
        np.full(len(empty), config.free_effective / len(empty)),
        np.ones(len(empty), bool),
    )
    return surface.joined(free)
