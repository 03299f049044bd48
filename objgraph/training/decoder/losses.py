"""What a sample's predicted distance is worth, against the one that was measured."""

from dataclasses import dataclass

from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import binary_cross_entropy_with_logits

from factors import checks
from objgraph.errors import ConfigError


@dataclass(frozen=True)
class LossConfig:
    """Weights of a sample's errors."""

    surface_scale: float = 0.05
    """Distance, canonical, at which a sample weighs half of one on the surface."""
    inside_weight: float = 4.0
    """Weight of a sample inside, of which thin parts have few: without it their junctions break."""
    sign_weight: float = 0.01
    """Weight of the cross-entropy of the sign: what is inside and what is not."""
    sign_scale: float = 0.01
    """Distance, canonical, at which a sign is as good as known."""

    def __post_init__(self) -> None:
        """Raises ConfigError where a number is not one of its kind."""
        checks.settings(self, ConfigError, surface_scale=checks.POSITIVE, sign_scale=checks.POSITIVE)


def sample_errors(
    prediction: Float[Tensor, "..."], sdf: Float[Tensor, "..."], config: LossConfig
) -> Float[Tensor, "..."]:
    """The errors of unclamped distances and of their signs."""
    distance = distance_errors(prediction, sdf, config.surface_scale, config.inside_weight)
    return distance + config.sign_weight * sign_errors(prediction, sdf, config.sign_scale)


def distance_errors(
    prediction: Float[Tensor, "..."], sdf: Float[Tensor, "..."], surface_scale: float, inside_weight: float
) -> Float[Tensor, "..."]:
    """Absolute errors of unclamped distances, weighted towards the surface and the inside."""
    weight = (1 + (inside_weight - 1) * (sdf < 0)) / (1 + sdf.abs() / surface_scale)
    return weight * (prediction - sdf).abs()


def sign_errors(
    prediction: Float[Tensor, "..."], sdf: Float[Tensor, "..."], scale: float
) -> Float[Tensor, "..."]:
    """Cross-entropy of which side samples are on; without it thin parts break, and matter is left between them."""
    return binary_cross_entropy_with_logits(-prediction / scale, (sdf < 0).to(prediction), reduction="none")
