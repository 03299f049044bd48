"""A network that says, of the points seen of an object, how it may stand, how large and of what shape it is.

It looks at the points as they would lie in the object's own frame if it stood at each of some headings, evenly spaced. One
PointNet (Qi et al., CVPR 2017) gives a heading's likelihood, another a Gaussian of what is left of the heading, the centre, the
scale and the code: in one network the Gaussian's steep gradients drown the heading's. They are trained on rendered views of the
prior's shapes (`objgraph.training.guess.train`).
"""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor, nn

from factors import checks
from objgraph.errors import PriorError
from objgraph.observation.clouds import FEATURES
from objgraph.observation.gravity_box import GravityBox

PLACE = 7
"""Heading in radians, centre, log-scale: what is said beside the code."""
_LOG_SIGMA = (-5.0, 1.0)
_APART = 8
"""Part of a full turn within which headings are one."""


@dataclass(frozen=True)
class FirstGuessConfig:
    """Size of the network."""

    code_length: int = 64
    headings: int = 16
    """That it looks at; a multiple of four that divides sixteen."""
    surface: int = 128
    """Points seen on the object that it takes."""
    free: int = 64
    """Points seen to be empty that it takes."""
    heading_width: int = 128
    """Of what the network of headings knows of each point."""
    place_width: int = 256
    """Of what that of places and codes does."""
    hidden: int = 256
    """Of what either knows of all points."""
    normals: bool = False
    """Whether it takes points' normals, and sees each heading beside its quarter turns; files of before do neither."""
    temperature: float = 5.0
    """Cost of the graph that counts as one nat beside its probabilities: costs are weighted energy scores, no log-likelihoods."""

    def __post_init__(self) -> None:
        """Raises PriorError where a number is not one of its kind."""
        some, wide = checks.Range(1), checks.Range(4)
        checks.settings(
            self, PriorError, code_length=some, surface=some, free=some, heading_width=wide, place_width=wide, hidden=some,
            temperature=checks.POSITIVE,
        )  # fmt: skip
        if self.headings not in (4, 8, 16):
            raise PriorError(f"a first guess looks at 4, 8 or 16 headings, not {self.headings!r}")

    def at(self, start: float) -> Float[np.ndarray, "h"]:
        """The headings from a first one on, radians."""
        return start + 2 * np.pi * np.arange(self.headings) / self.headings


@dataclass(frozen=True)
class Guesses:
    """For each of `b` objects and `h` headings."""

    log_probability: Float[Tensor, "b h"]
    mean: Float[Tensor, "b h 7+l"]
    """Heading about the one looked at, centre from the seen box' and logarithm of the scale, in units and the box' frame; code."""
    log_sigma: Float[Tensor, "b h 7+l"]


class FirstGuess(nn.Module):
    """How some objects may stand."""

    def __init__(self, config: FirstGuessConfig | None = None) -> None:
        super().__init__()
        self.config = config = config or FirstGuessConfig()
        features = FEATURES if config.normals else FEATURES - 3
        self.heading = PointNet(features, config.heading_width, config.hidden, 1, config.normals)
        self.place = PointNet(features, config.place_width, config.hidden, 2 * (PLACE + config.code_length))

    def forward(self, points: Float[Tensor, "b h p 11"], size: Float[Tensor, "b h 3"]) -> Guesses:
        """Of points in the frames of their seen boxes at each heading, and the boxes' edges, in units."""
        logits = self.heading(points, size)[..., 0]
        return Guesses(logits.log_softmax(dim=-1), *gaussian(self.place(points, size)))


class PointNet(nn.Module):
    """Of sets of points and the edges of their boxes, some numbers."""

    def __init__(self, features: int, width: int, hidden: int, out: int, quarters: bool = False) -> None:
        super().__init__()
        self.features = features
        self.each = nn.Sequential(
            nn.Linear(features, width // 4), nn.ReLU(), nn.Linear(width // 4, width // 2), nn.ReLU(),
            nn.Linear(width // 2, width), nn.ReLU(),
        )  # fmt: skip
        known = 2 * width + 3
        self.one = nn.Sequential(nn.Linear(known, hidden), nn.ReLU()) if quarters else None
        self.all = nn.Sequential(
            nn.Linear(4 * hidden if quarters else known, hidden), nn.ReLU(), nn.Linear(hidden, hidden), nn.ReLU(),
            nn.Linear(hidden, out),
        )  # fmt: skip

    def forward(self, points: Float[Tensor, "*b p 11"], size: Float[Tensor, "*b 3"]) -> Float[Tensor, "*b o"]:
        """Where it looks at quarter turns the last of `*b` are headings all around."""
        each = self.each(points[..., : self.features])
        seen = torch.cat([each.amax(dim=-2), each.mean(dim=-2), size.log().to(each.dtype)], dim=-1)
        if self.one is not None:
            quarter = points.shape[-3] // 4
            seen = self.one(seen)
            seen = torch.cat([seen.roll(-k * quarter, dims=-2) for k in range(4)], dim=-1)
        return self.all(seen).float()


def gaussian(said: Float[Tensor, "*b 2*n"]) -> tuple[Float[Tensor, "*b n"], Float[Tensor, "*b n"]]:
    """Mean and logarithm of the standard deviation."""
    mean, log_sigma = said.chunk(2, dim=-1)
    return mean, log_sigma.clamp(*_LOG_SIGMA)


def modes(probability: Float[np.ndarray, "h"]) -> list[tuple[int, float]]:
    """Headings that are likelier than those within an eighth of a turn, each with the probability of all of these, the likeliest
    first. What lies between two is the likelier one's."""
    left, count = np.array(probability, float), len(probability)
    reach = np.arange(-(count // _APART), count // _APART + 1)
    found = []
    while (left >= 0).any():
        peak = int(left.argmax())
        about = (peak + reach) % count
        # of single precision's probabilities the sum may be a hair above one
        found.append((peak, min(float(left[about].clip(0).sum()), 1.0)))
        left[about] = -1.0
    return sorted(found, key=lambda mode: -mode[1])


def place_in(
    box: GravityBox, unit: float, T_world_object: Float[np.ndarray, "4 4"], log_scale: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "*h 7"]:
    """Heading, centre and log-scale of an upright object in the frame of a seen box, or of each of some."""
    R_box_world = np.swapaxes(box.R_world_object, -1, -2)
    x_box = R_box_world @ T_world_object[:3, 0]
    away = (T_world_object[:3, 3] - box.centre_world)[..., None]
    size = np.broadcast_to(log_scale - np.log(unit), x_box.shape)
    heading = np.arctan2(-x_box[..., 2:], x_box[..., :1])
    return np.concatenate([heading, (R_box_world @ away)[..., 0] / unit, size], axis=-1)


def placed(
    box: GravityBox, unit: float, place: Float[np.ndarray, "7"]
) -> tuple[Float[np.ndarray, "4 4"], Float[np.ndarray, "3"]]:
    """T_world_object and log-scale: the inverse of `place_in`."""
    c, s = np.cos(place[0]), np.sin(place[0])
    T_world_object = np.eye(4)
    T_world_object[:3, :3] = box.R_world_object @ [[c, 0, s], [0, 1, 0], [-s, 0, c]]
    T_world_object[:3, 3] = box.centre_world + unit * box.R_world_object @ place[1:4]
    return T_world_object, place[4:7] + np.log(unit)
