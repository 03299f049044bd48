"""What a prior's first guess proposes for an object that is seen: likely states, each with its probability."""

from collections.abc import Sequence
from dataclasses import dataclass

import gtsam
import numpy as np
import torch
from jaxtyping import Float

from factors.state import ObjectState
from objgraph.errors import InitialisationError
from objgraph.observation.clouds import cloud, view_cloud
from objgraph.observation.sampling import ObjectView
from objgraph.priors.first_guess import PLACE, place_from_quarter
from objgraph.priors.shape_prior import ShapePrior

_FEWEST = 10


@dataclass(frozen=True)
class Proposal:
    """One way in which an object may stand."""

    probability: float
    """Of its heading's quarter."""
    state: ObjectState


def proposals(
    prior: ShapePrior, views: Sequence[ObjectView], up_world: Float[np.ndarray, "3"], floor: float | None
) -> list[Proposal]:
    """The four headings of a prior with a first guess, the likeliest first.

    `floor` is its height along `up_world`, metres.

    Raises:
        InitialisationError: there are too few points to put a box about.
    """
    assert prior.guess is not None
    clouds = [view_cloud(view) for view in views]
    if (count := sum(len(each.surface) for each in clouds)) < _FEWEST:
        raise InitialisationError(f"{count} points are too few to place an object; add views of it")
    config, unit = prior.guess.config, prior.size_mean
    floor = floor if prior.stands else None
    seen = cloud(clouds, up_world, floor, unit, config.surface, config.free, np.random.default_rng(0))
    like = next(prior.guess.parameters())
    with torch.no_grad():
        said = prior.guess(
            torch.from_numpy(seen.points)[None].to(like), torch.as_tensor(seen.box.size / unit)[None].to(like)
        )
    result = []
    for quarter in np.argsort(-said.log_probability[0].cpu().numpy(), kind="stable"):
        mean = said.mean[0, quarter].cpu().double().numpy()
        T_world_object, log_scale = place_from_quarter(seen.box, unit, int(quarter), mean[:PLACE])
        state = ObjectState(gtsam.Pose3(T_world_object), log_scale, mean[PLACE:])
        result.append(Proposal(float(said.log_probability[0, quarter].exp()), state))
    return result
