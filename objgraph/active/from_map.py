"""The objects of a saved map as active vision takes them."""

from collections.abc import Collection, Sequence

import gtsam

from objgraph.active.target import Target, target
from objgraph.errors import ActiveVisionError, MapError
from objgraph.maps.mapped_object import MappedObject
from objgraph.maps.object_map import ObjectMap
from objgraph.priors.registry import prior_for
from objgraph.priors.shape_prior import ShapePrior


def targets_from_map(
    object_map: ObjectMap, ids: Collection[int] = (), priors: Sequence[ShapePrior] = (), points: int = 600
) -> list[Target]:
    """The mapped objects, or those of some ids, each once and decoded by the prior that it was mapped with.

    Raises:
        ActiveVisionError: no object is mapped, or one that is asked for is not.
        MapError: an object has no joint covariance, or was mapped with another prior than the one at hand.
    """
    mapped = {entry.id: entry for entry in object_map.mapped}
    missing = sorted(set(ids) - set(mapped))
    if missing or not mapped:
        what = f"objects {missing} are not" if missing else "no object is"
        raise ActiveVisionError(f"map of {object_map.scene}: {what} mapped; mapped are {sorted(mapped)}")
    chosen = [mapped[i] for i in dict.fromkeys(ids)] if ids else [*mapped.values()]
    by_category = {entry.category: prior_for(entry.category, priors) for entry in chosen}
    found = []
    for entry in chosen:
        prior = by_category[entry.category]
        _check_prior(entry, prior)
        name = entry.name
        seen_from = [gtsam.Pose3(T) for T in entry.cameras] if entry.cameras is not None else []
        found.append(target(
            name, prior, entry.state, entry.uncertainty,
            seen_from=seen_from, turns=entry.other_headings, points=points,
        ))  # fmt: skip
    return found


def _check_prior(entry: MappedObject, prior: ShapePrior) -> None:
    """A code means nothing to another decoder."""
    found = prior.digest
    if entry.prior is not None and entry.prior.hash != found:
        raise MapError(
            f"object {entry.id} ({entry.category}) was mapped with prior {entry.prior.name} {entry.prior.hash[:12]}, "
            f"the one at hand is {found[:12]}: give its file, or map it again"
        )
