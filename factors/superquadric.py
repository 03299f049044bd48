"""An analytic decoder: boxes, cylinders and ellipsoids, for objects of which no shapes were learnt.

Barr, "Superquadrics and Angle-Preserving Transformations", IEEE CG&A 1981, with a linear taper along the up axis.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from factors import checks
from factors.errors import FactorError
from factors.sdf_decoder import SdfDecoder

SEMI_AXIS = 0.5 / 3**0.5
"""Of every superquadric along y, and along x and z half-way up: untapered, a cube of diagonal 1 holds it."""

_ROUNDING = 1e-6
"""Added to squared coordinates (in semi-axes), so that logarithms have derivatives in the middle planes."""


@dataclass(frozen=True)
class SuperquadricConfig:
    """Which superquadrics there are."""

    roundest: float = 2.0
    """Smallest exponent: 2 is an ellipse."""
    squarest: float = 10.0
    """Largest exponent: infinity is a rectangle."""
    taper: float = 0.3
    """Largest change of width from the middle to the top, as a share of it."""

    def __post_init__(self) -> None:
        """Raises FactorError where the exponents are below 2 or do not rise, or the taper leaves no width."""
        exponents = checks.Range(2.0, 1000.0)
        checks.settings(self, roundest=exponents, squarest=exponents, taper=checks.Range(0.0, 0.95))
        if self.roundest > self.squarest:
            raise FactorError(f"the exponents {self.roundest} to {self.squarest} do not rise")


class Superquadric(SdfDecoder):
    """Signed distance to a superquadric, to first order and by no more than a factor of about two elsewhere.

    The code is [section, profile, taper], each a real number: large values square the horizontal section, square
    the vertical profile, and widen the top; 0 is half-way. With exponents p (section) and q (profile), both at
    least 2, `g = ((|x|^p + |z|^p)^(q/p) + |y|^q)^(1/q)` is a norm; the distance is semi-axis * (g - 1). It has
    gradient norm 1 at the middles of the faces and nowhere less than 1/sqrt(3), but for the taper.
    """

    config: SuperquadricConfig

    def __init__(self, config: SuperquadricConfig | None = None) -> None:
        super().__init__()
        self.config = checks.settings_or_default(config, SuperquadricConfig)
        self._like: Tensor
        self.register_buffer("_like", torch.empty(0), persistent=False)

    @property
    def code_length(self) -> int:
        return 3

    @property
    def like(self) -> Tensor:
        return self._like

    def _enter(self, codes: Float[Tensor, "b 3"]) -> dict[str, Float[Tensor, "b 3"]]:
        return {"code": codes}

    def _d_enter(self, codes: Float[Tensor, "b 3"]) -> dict[str, Float[Tensor, "1 3 3"]]:
        return {"code": torch.eye(3).to(codes)[None]}

    def _network(
        self, points: Float[Tensor, "n 3"], injected: dict[str, Float[Tensor, "m 3"]]
    ) -> Float[Tensor, "n"]:
        config = self.config
        section, profile, taper = injected["code"].unbind(dim=1)
        p = config.roundest + (config.squarest - config.roundest) * section.sigmoid()
        q = config.roundest + (config.squarest - config.roundest) * profile.sigmoid()
        x, y, z = (points / SEMI_AXIS).unbind(dim=1)
        # beyond the object's height the width stays what it is there: it must not shrink to nothing
        width = 1 + config.taper * taper.tanh() * y.clamp(-1, 1)
        level = torch.logaddexp(p * _log(x / width), p * _log(z / width)) / p
        g = (torch.logaddexp(q * level, q * _log(y)) / q).exp()
        return SEMI_AXIS * (g - 1)


def _log(coordinate: Float[Tensor, "n"]) -> Float[Tensor, "n"]:
    """Logarithm of the absolute value."""
    return 0.5 * (coordinate.square() + _ROUNDING).log()
