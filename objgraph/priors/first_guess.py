"""A network that says, of the points seen of an object, how it may stand, how large and of what shape it is.

Of each of four headings, quarter turns of the seen box, it looks at the points as they would lie in the object's own frame.
One PointNet (Qi et al., CVPR 2017) gives the heading's likelihood, another a Gaussian of the heading within the quarter, the
centre, the scale and the code: in one network the Gaussian's steep gradients drown the heading's. They are trained on rendered
views of the prior's shapes (`objgraph.training.train_guess`).
"""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor, nn

from objgraph.observation.clouds import FEATURES
from objgraph.observation.gravity_box import GravityBox

QUARTERS = 4
PLACE = 7
"""Heading in radians, centre, log-scale: what is said beside the code."""
_LOG_SIGMA = (-5.0, 1.0)


@dataclass(frozen=True)
class FirstGuessConfig:
    """Size of the network."""

    code_length: int = 64
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


@dataclass(frozen=True)
class Guesses:
    """For each of `b` objects and four headings."""

    log_probability: Float[Tensor, "b 4"]
    mean: Float[Tensor, "b 4 7+l"]
    """Heading about the quarter, centre from the seen box' and logarithm of the scale, in units and the frame of the quarter;
    code."""
    log_sigma: Float[Tensor, "b 4 7+l"]


class FirstGuess(nn.Module):
    """Four headings of each of some clouds."""

    def __init__(self, config: FirstGuessConfig | None = None) -> None:
        super().__init__()
        self.config = config = config or FirstGuessConfig()
        self.heading = PointNet(config.heading_width, config.hidden, 1)
        self.place = PointNet(config.place_width, config.hidden, 2 * (PLACE + config.code_length))

    def forward(self, points: Float[Tensor, "b p 8"], size: Float[Tensor, "b 3"]) -> Guesses:
        """Of points in the frames of their seen boxes, and the boxes' edges, in units."""
        turned = [seen_in_quarter(points, size, k) for k in range(QUARTERS)]
        logits = torch.cat([self.heading(*each) for each in turned], dim=-1)
        places = torch.stack([self.place(*each) for each in turned], dim=1)
        return Guesses(logits.log_softmax(dim=-1), *gaussian(places))


class PointNet(nn.Module):
    """Of a set of points and the edges of their box, some numbers."""

    def __init__(self, width: int, hidden: int, out: int) -> None:
        super().__init__()
        self.each = nn.Sequential(
            nn.Linear(FEATURES, width // 4), nn.ReLU(), nn.Linear(width // 4, width // 2), nn.ReLU(),
            nn.Linear(width // 2, width), nn.ReLU(),
        )  # fmt: skip
        self.all = nn.Sequential(
            nn.Linear(2 * width + 3, hidden), nn.ReLU(), nn.Linear(hidden, hidden), nn.ReLU(), nn.Linear(hidden, out)
        )  # fmt: skip

    def forward(self, points: Float[Tensor, "b p 8"], size: Float[Tensor, "b 3"]) -> Float[Tensor, "b o"]:
        each = self.each(points)
        seen = torch.cat([each.amax(dim=1), each.mean(dim=1), size.log().to(each.dtype)], dim=-1)
        return self.all(seen).float()


def gaussian(said: Float[Tensor, "*b 2*n"]) -> tuple[Float[Tensor, "*b n"], Float[Tensor, "*b n"]]:
    """Mean and logarithm of the standard deviation."""
    mean, log_sigma = said.chunk(2, dim=-1)
    return mean, log_sigma.clamp(*_LOG_SIGMA)


def seen_in_quarter(
    points: Float[Tensor, "b p 8"], size: Float[Tensor, "b 3"], quarters: int
) -> tuple[Float[Tensor, "b p 8"], Float[Tensor, "b 3"]]:
    """Clouds, and the edges of their boxes, in the frame that is turned by so many quarters."""
    return quarter_turned(points, quarters), size if quarters % 2 == 0 else size[:, [2, 1, 0]]


def quarter_turned(points: Float[Tensor, "... 8"], quarters: int) -> Float[Tensor, "... 8"]:
    """The cloud in a frame that is turned by so many quarters about y."""
    x, y, z, dx, dy, dz, height, free = points.unbind(-1)
    for _ in range(quarters % QUARTERS):
        x, z, dx, dz = -z, x, -dz, dx
    return torch.stack([x, y, z, dx, dy, dz, height, free], dim=-1)


def place_in_quarter(
    box: GravityBox, unit: float, T_world_object: Float[np.ndarray, "4 4"], log_scale: Float[np.ndarray, "3"]
) -> tuple[int, Float[np.ndarray, "7"]]:
    """Of an upright object: the nearest quarter turn of its seen box, and heading, centre and log-scale in it."""
    R = box.R_world_object.T @ T_world_object[:3, :3]
    heading = float(np.arctan2(R[0, 2], R[0, 0]))
    quarter = round(heading / (np.pi / 2))
    centre = _about_y(quarter).T @ box.R_world_object.T @ (T_world_object[:3, 3] - box.centre_world) / unit
    return quarter % QUARTERS, np.array([heading - quarter * np.pi / 2, *centre, *(log_scale - np.log(unit))])


def place_from_quarter(
    box: GravityBox, unit: float, quarter: int, place: Float[np.ndarray, "7"]
) -> tuple[Float[np.ndarray, "4 4"], Float[np.ndarray, "3"]]:
    """T_world_object and log-scale: the inverse of `place_in_quarter`."""
    T_world_object = np.eye(4)
    R_world_quarter = box.R_world_object @ _about_y(quarter)
    c, s = np.cos(place[0]), np.sin(place[0])
    T_world_object[:3, :3] = R_world_quarter @ [[c, 0, s], [0, 1, 0], [-s, 0, c]]
    T_world_object[:3, 3] = box.centre_world + unit * R_world_quarter @ place[1:4]
    return T_world_object, place[4:7] + np.log(unit)


def _about_y(quarters: int) -> Float[np.ndarray, "3 3"]:
    c, s = [(1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0)][quarters % QUARTERS]
    return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])
