"""A map against ground truth."""

import logging
from collections.abc import Mapping
from dataclasses import asdict, replace

from objgraph.bench.metrics.metrics import evaluate_object
from objgraph.errors import EvaluationError
from objgraph.maps.mapped_object import MappedObject
from objgraph.maps.object_map import ObjectMap
from objgraph.observation.frames import GroundTruth

log = logging.getLogger(__name__)


def evaluated(object_map: ObjectMap, truths: Mapping[int, GroundTruth], seed: int = 0) -> ObjectMap:
    """The map with the errors of every object that has ground truth.

    An object that failed, or whose surface cannot be measured, counts as wrong. `seed` draws the points of the
    Chamfer distance.
    """
    return replace(
        object_map,
        objects=tuple(
            _evaluated(entry, truths[entry.id], seed) if entry.id in truths else entry
            for entry in object_map.objects
        ),
    )


def _evaluated(entry: MappedObject, truth: GroundTruth, seed: int) -> MappedObject:
    wrong = replace(entry, evaluation={"pose_correct": False})
    if entry.vertices is None or entry.faces is None or entry.T_world_object is None or entry.scale is None:
        return wrong
    R, t = entry.T_world_object[:3, :3], entry.T_world_object[:3, 3]
    p_object = (entry.vertices - t) @ R / entry.scale
    try:
        errors = evaluate_object(entry.T_world_object, entry.scale, p_object, entry.faces, truth, seed)
    except EvaluationError as error:
        log.warning("%s %d cannot be evaluated: %s", entry.category, entry.id, error)
        return wrong
    return replace(entry, evaluation=asdict(errors))
