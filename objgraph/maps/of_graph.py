"""A map of the objects that a graph holds, to be looked at and saved as any other."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol

from factors import checks
from objgraph.errors import CovarianceError, MapError, ObjectGraphError, ObservationError
from objgraph.estimate.task import Estimate
from objgraph.maps.entry import Numbered, failed_entry, map_entry, with_trust
from objgraph.maps.mapped_object import MappedObject
from objgraph.maps.object_map import ObjectMap
from objgraph.priors.mesh import RESOLUTION
from objgraph.trust.calibration import Calibration, shipped_calibration
from objgraph.trust.judge import Handle, Objects, covariance_in, estimate_in


class ObjectsInGraph(Objects, Protocol):
    """`ObjectGraph`, `IncrementalObjectGraph`, `ObjectFrontEnd`."""

    @property
    def objects(self) -> Sequence[Any]: ...


def map_of(
    objects: ObjectsInGraph,
    scene: str = "graph",
    calibration: Calibration | None = None,
    resolution: int = RESOLUTION,
) -> ObjectMap:
    """A graph's objects as they stand there now: meshes in the world, covariances, verdicts and calibrated boxes.

    An object's `id` is the number that its name ends with, or its place among `objects.objects` where names have none of their own. One
    that cannot be mapped is a failed one, with its reason. One without views (behind a lag) has no verdict, nor has one that the
    calibration, by default the shipped one, knows nothing of. Meshes are cut at `resolution` cells along an edge.

    Raises:
        ObservationError: the graph does not know which way is up.
        MapError: the scene is no text.
        CovarianceError: the calibration is none.
    """
    known = shipped_calibration() if calibration is None else calibration
    checks.instance("calibration", known, Calibration, CovarianceError)
    up_world = objects.builder.up_world
    if up_world is None:
        raise ObservationError("a map needs to know which way is up: give the graph `up_world`")
    handles = list(objects.objects)
    entries = [
        _entry(objects, handle, _Numbered(number, handle.prior.category), known, resolution)
        for number, handle in zip(_numbers(handles), handles, strict=True)
    ]
    return ObjectMap(checks.text("scene", scene, MapError), tuple(entries), up_world)


@dataclass(frozen=True)
class _Numbered:
    id: int
    category: str


def _entry(
    objects: ObjectsInGraph, handle: Handle, instance: Numbered, known: Calibration, resolution: int
) -> MappedObject:
    try:
        views, prior = objects.views(handle), handle.prior
        if (
            not views or known.of(prior.category, prior.digest) is None
        ):  # nothing to judge: no first guess is asked
            state, turns = objects.state(handle), handle.other_headings
            turns = None if turns is None else turns.carried(state)
            alone = Estimate.of_graph(state, covariance_in(objects, handle), turns)
            return replace(map_entry(instance, prior, alone, views, resolution), estimator="graph")
        task, estimate = estimate_in(objects, handle)
        entry = map_entry(instance, prior, estimate, views, resolution)
        return replace(with_trust(entry, task, estimate, known), estimator="graph")
    except ObjectGraphError as error:
        return failed_entry(instance, error)


def _numbers(handles: Sequence[Handle]) -> list[int]:
    said = [re.search(r" ([0-9]{1,9})$", each.name) for each in handles]
    numbers = [int(each[1]) for each in said if each is not None]
    return numbers if len(set(numbers)) == len(handles) else list(range(len(handles)))
