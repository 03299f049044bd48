"""What a prior's first guess proposes for an object that is seen: likely states, each with its probability."""

from collections.abc import Sequence
from dataclasses import dataclass

import gtsam
import numpy as np
import torch
from jaxtyping import Float

from factors.state import ObjectState
from objgraph.errors import InitialisationError
from objgraph.observation.clouds import clouds, view_cloud
from objgraph.observation.gravity_box import smallest_heading
from objgraph.observation.sampling import ObjectView
from objgraph.priors.first_guess import PLACE, modes, placed
from objgraph.priors.shape_prior import ShapePrior

_FEWEST = 10


@dataclass(frozen=True)
class Proposal:
    """One way in which an object may stand."""

    probability: float
    """Of its heading and those about it."""
    state: ObjectState


def proposals(
    prior: ShapePrior, views: Sequence[ObjectView], up_world: Float[np.ndarray, "3"], floor: float | None
) -> list[Proposal]:
    """How an object may stand by its prior's first guess, the likeliest first.

    `floor` is its height along `up_world`, metres.

    Raises:
        InitialisationError: there are too few points to put a box about.
    """
    assert prior.guess is not None
    seen = [view_cloud(view) for view in views]
    p_world = np.concatenate([each.surface for each in seen]) if seen else np.zeros((0, 3))
    if len(p_world) < _FEWEST:
        raise InitialisationError(f"{len(p_world)} points are too few to place an object; add views of it")
    config, unit = prior.guess.config, prior.size_mean
    floor = floor if prior.stands else None
    headings = config.at(smallest_heading(p_world, up_world))
    rng = np.random.default_rng(0)
    looked = clouds(seen, up_world, floor, unit, headings, config.surface, config.free, rng)
    like = next(prior.guess.parameters())
    with torch.no_grad():
        said = prior.guess(
            torch.from_numpy(looked.points)[None].to(like),
            torch.as_tensor(looked.box.size / unit)[None].to(like),
        )
    result = []
    for k, probability in modes(said.log_probability[0].exp().cpu().double().numpy()):
        mean = said.mean[0, k].cpu().double().numpy()
        T_world_object, log_scale = placed(looked.box[k], unit, mean[:PLACE])
        state = ObjectState(gtsam.Pose3(T_world_object), log_scale, mean[PLACE:])
        result.append(Proposal(probability, state))
    return result
