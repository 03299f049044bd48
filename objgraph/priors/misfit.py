"""What a prior's shapes leave out of an object's box."""

from dataclasses import dataclass

_LEAST = 0.25
"""Of what views usually cost: a lucky one makes no object certain."""


@dataclass(frozen=True)
class BoxMisfit:
    """How far the box of a real object lies from that of the best shape that a prior can make of it.

    No covariance of pose, scale and code knows of it: it says how well these are known, not what they leave out. It is
    measured on development objects (docs/decisions/2026-11-covariances.md) and kept with the prior; the defaults are for one of which nothing
    was measured.
    """

    centre: float = 0.005
    """Standard deviation of each coordinate of the centre, metres."""
    log_level: float = 0.06
    """Standard deviation of the logarithms of width and depth: legs splay, backs lean, arms reach out."""
    log_height: float = 0.007
    """Standard deviation of the height's logarithm: the floor is known, and tops are seen."""
    marginals: float = 1.0
    """Factor on the variances that the marginals give the box."""
    view_cost: float = 50.0
    """What a view of an object usually costs, in the factors' scores. Of one that costs more the prior makes less, and all
    variances are as many times larger, as least squares has it of squared residuals: the variance of unit weight, a
    posteriori (Mikhail, "Observations and Least Squares", 1976)."""

    def __post_init__(self) -> None:
        """Raises:
        ValueError: a spread or the factor is negative, or usual views cost nothing.
        """
        if not (min(self.centre, self.log_level, self.log_height, self.marginals) >= 0 < self.view_cost):
            raise ValueError(f"negative spreads, or no usual cost: {self}")

    def share(self, view_cost: float | None) -> float:
        """Factor on all variances of an object whose views cost so much; one where that is not known."""
        return 1.0 if view_cost is None else max(view_cost / self.view_cost, _LEAST)
