"""A network that says, of the points seen of an object, how it may stand, how large and of what shape it is.

Of each of four headings, quarter turns of the seen box, it looks at the points as they would lie in the object's own frame
(Qi et al., "PointNet", CVPR 2017) and gives the heading's likelihood and a Gaussian of the heading within the quarter, the
centre, the scale and the code. It is trained on rendered views of the prior's shapes (`objgraph.training.train_guess`).
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
    surface: int = 256
    """Points seen on the object that it takes."""
    free: int = 128
    """Points seen to be empty that it takes."""
    width: int = 256
    """Of what is known of each point."""
    hidden: int = 384
    """Of what is known of all."""


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
        w, h = config.width, config.hidden
        self.each = nn.Sequential(
            nn.Linear(FEATURES, w // 4), nn.ReLU(), nn.Linear(w // 4, w // 2), nn.ReLU(), nn.Linear(w // 2, w), nn.ReLU()
        )  # fmt: skip
        self.all = nn.Sequential(nn.Linear(2 * w + 3, h), nn.ReLU(), nn.Linear(h, h), nn.ReLU())
        self.out = nn.Linear(h, 1 + 2 * (PLACE + config.code_length))

    def forward(self, points: Float[Tensor, "b p 8"], size: Float[Tensor, "b 3"]) -> Guesses:
        """Of points in the frames of their seen boxes, and the boxes' edges, in units."""
        turned = torch.stack([quarter_turned(points, k) for k in range(QUARTERS)], dim=1)
        edges = torch.stack([size if k % 2 == 0 else size[:, [2, 1, 0]] for k in range(QUARTERS)], dim=1)
        each = self.each(turned)
        seen = torch.cat([each.amax(dim=2), each.mean(dim=2), edges.log().to(each.dtype)], dim=-1)
        out = self.out(self.all(seen)).float()
        logit, rest = out[..., 0], out[..., 1:]
        mean, spread = rest.chunk(2, dim=-1)
        return Guesses(logit.log_softmax(dim=-1), mean, spread.clamp(*_LOG_SIGMA))


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
