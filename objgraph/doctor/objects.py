"""Checks of masks and objects: what the masks show against what is named, and the depth behind them."""

import numpy as np
from jaxtyping import Float

from objgraph.doctor.section import Finding, Section, listed
from objgraph.doctor.seen import Seen
from objgraph.observation.frames import Instance
from objgraph.priors.categories import category_of
from objgraph.priors.registry import available_priors

WITH_DEPTH = 0.5
"""Share of an object's mask that must have depth: with less, what is not measured decides its shape."""
_NEAR_M = 0.5
"""Between what two frames show of an object, along any axis: more is another object, however it is turned."""
_APART = 0.3
"""Share of an object's pairs of frames that may be farther apart: masks have stray pixels."""
_FRAMES = 30
"""Of an object that are compared, evenly over the scan."""


def examine_objects(seen: Seen, all_named: bool, placed: bool) -> Section:
    """Each object with how well it is seen; `all_named`: whether every id of the masks should be an object's; `placed`: whether
    nothing is wrong with depth and poses."""
    rows, findings = [], []
    for instance in seen.scan.instances:
        row, found = _object(seen, instance)
        rows.append(row)
        findings += found
    if all_named:
        findings += _unnamed(seen)
    if placed:
        findings += _in_several_places(seen)
    findings += _without_prior(seen)
    return Section("Objects", tuple(rows), tuple(findings))


def _object(seen: Seen, instance: Instance) -> tuple[tuple[str, str], list[Finding]]:
    name = f"{instance.category} {instance.id}"
    pixels = [frame.pixels[instance.id] for frame in seen.frames if instance.id in frame.pixels]
    prior = f"prior {category_of(instance.category)}" if _has_prior(instance) else "no prior"
    if not pixels:
        do = f"give its pixels the value {instance.id} in masks/, or take it out of the list of objects"
        return (name, f"{prior}, never seen"), [Finding(name, "is named, and no mask shows it", do)]
    with_depth = sum(frame.pixels_with_depth.get(instance.id, 0) for frame in seen.frames)
    share = with_depth / sum(pixels)
    value = (
        f"{prior}, in {len(pixels)} of {len(seen.frames)} frames, {np.median(pixels):.0f} pixels in the median one, "
        f"{share:.0%} with depth"
    )
    if share >= WITH_DEPTH:
        return (name, value), []
    what = f"only {share:.0%} of its mask's pixels have depth"
    do = (
        "check that masks and depth show the same view; glass, black and shiny things have no depth and are not mapped "
        "well: take it out of the list of objects"
    )
    return (name, value), [Finding(name, what, do)]


def _unnamed(seen: Seen) -> list[Finding]:
    named = {instance.id for instance in seen.scan.instances}
    frames: dict[int, list[str]] = {}
    for frame in seen.frames:
        for identity in frame.pixels.keys() - named:
            frames.setdefault(identity, []).append(frame.name)
    if not frames:
        return []
    ids = [f"{identity} (in {len(frames[identity])} frames)" for identity in sorted(frames)]
    what = f"the masks have ids that are not named: {listed(ids, 6)}"
    do = "name them in instances.json, or set these pixels to 0"
    return [Finding("masks", what, do)]


def _in_several_places(seen: Seen) -> list[Finding]:
    """Ids that mean one thing in one frame and another in the next."""
    torn = []
    for instance in seen.scan.instances:
        shown = [frame.points[instance.id] for frame in seen.frames if len(frame.points.get(instance.id, ()))]
        chosen = [
            shown[i] for i in np.unique(np.linspace(0, len(shown) - 1, min(_FRAMES, len(shown))).astype(int))
        ]
        if len(chosen) > 1 and _apart(chosen) > _APART:
            torn.append(f"{instance.category} {instance.id}")
    if not torn:
        return []
    what = f"what frames show of {listed(torn, 6)} lies in places apart from each other"
    do = (
        "give an object the same id in all frames: of masks made image by image, `objgraph segment` joins those of one object; "
        "objects that move are not mapped"
    )
    return [Finding("masks", what, do)]


def _apart(shown: list[Float[np.ndarray, "n 3"]]) -> float:
    """Share of the pairs of frames whose points are in boxes apart; a few stray points are left out of each."""
    low, high = (np.array([np.percentile(points, q, axis=0) for points in shown]) for q in (10, 90))
    gap = np.maximum(low[:, None] - high[None], low[None] - high[:, None]).max(axis=2)
    pairs = np.triu_indices(len(shown), 1)
    return float((gap[pairs] > _NEAR_M).mean())


def _without_prior(seen: Seen) -> list[Finding]:
    categories = sorted({each.category for each in seen.scan.instances if not _has_prior(each)})
    if not categories:
        return []
    what = f"there is no shape prior for {', '.join(categories)}: a superquadric stands in"
    do = f"priors are there for {', '.join(available_priors())}; `objgraph train` makes one"
    return [Finding("objects", what, do, note=True)]


def _has_prior(instance: Instance) -> bool:
    return category_of(instance.category) in available_priors()
