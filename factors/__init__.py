"""GTSAM factors over an object's pose, scale and learnt shape code."""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from factors.base import Annealing, ObservationFactor
    from factors.batch import prefetch
    from factors.code_mixture import CodeMixture, mixture_prior
    from factors.decoder import Decoder, DecoderConfig
    from factors.depth import DepthFactor, RaySampling
    from factors.errors import FactorError, NotFiniteError, ObjectGraphError
    from factors.filled_box import FilledBoxFactor
    from factors.floor import FloorFactor, floor_share
    from factors.full_distribution import FullDistribution
    from factors.gaussian_depth import Deterministic, Probabilistic, Sampled
    from factors.linearized import linearized
    from factors.priors import code_prior, placed_prior, scale_prior, sized_prior, upright_prior
    from factors.proportions import Proportions, proportions_prior
    from factors.rays import Rays
    from factors.score import energy_score
    from factors.sdf_decoder import SdfDecoder
    from factors.state import ObjectKeys, ObjectState
    from factors.surface import SurfaceFactor

__all__ = [
    "Annealing",
    "CodeMixture",
    "Decoder",
    "DecoderConfig",
    "DepthFactor",
    "Deterministic",
    "FactorError",
    "FilledBoxFactor",
    "FloorFactor",
    "FullDistribution",
    "NotFiniteError",
    "ObjectGraphError",
    "ObjectKeys",
    "ObjectState",
    "ObservationFactor",
    "Probabilistic",
    "Proportions",
    "RaySampling",
    "Rays",
    "Sampled",
    "SdfDecoder",
    "SurfaceFactor",
    "code_prior",
    "energy_score",
    "floor_share",
    "linearized",
    "mixture_prior",
    "placed_prior",
    "prefetch",
    "proportions_prior",
    "scale_prior",
    "sized_prior",
    "upright_prior",
]

_HOMES = {
    "factors.base": "Annealing ObservationFactor",
    "factors.batch": "prefetch",
    "factors.code_mixture": "CodeMixture mixture_prior",
    "factors.decoder": "Decoder DecoderConfig",
    "factors.depth": "DepthFactor RaySampling",
    "factors.errors": "FactorError NotFiniteError ObjectGraphError",
    "factors.filled_box": "FilledBoxFactor",
    "factors.floor": "FloorFactor floor_share",
    "factors.full_distribution": "FullDistribution",
    "factors.gaussian_depth": "Deterministic Probabilistic Sampled",
    "factors.linearized": "linearized",
    "factors.priors": "code_prior placed_prior scale_prior sized_prior upright_prior",
    "factors.proportions": "Proportions proportions_prior",
    "factors.rays": "Rays",
    "factors.score": "energy_score",
    "factors.sdf_decoder": "SdfDecoder",
    "factors.state": "ObjectKeys ObjectState",
    "factors.surface": "SurfaceFactor",
}
_HOME_OF = {name: home for home, names in _HOMES.items() for name in names.split()}


def __getattr__(name: str):
    # torch and gtsam are loaded when something is first asked for, not with every submodule
    if name in _HOME_OF:
        return getattr(import_module(_HOME_OF[name]), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return [*__all__]
