"""A map against ground truth."""

import json
import logging
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

from objgraph.atomic import write_file
from objgraph.datasets.ground_truth import GroundTruth
from objgraph.errors import EvaluationError
from objgraph.geometry.frames import transformed_back
from objgraph.maps.files import EVALUATION
from objgraph.maps.mapped_object import MappedObject
from objgraph.maps.object_map import ObjectMap
from objgraph.metrics.objects import Evaluation, evaluate_object

log = logging.getLogger(__name__)

ERROR_KEYS = tuple(field.name for field in fields(Evaluation))
"""What is measured of each object; a value that could not be measured is None."""
_WRONG = dict.fromkeys(ERROR_KEYS) | {"pose_correct": False}
"""Of an object that failed."""


@dataclass(frozen=True)
class MapErrors:
    """The errors of those objects of a map that have ground truth."""

    scene: str
    objects: Mapping[int, Mapping[str, Any]]
    """`ERROR_KEYS` by object id; of a failed object `pose_correct` is False and the rest None."""

    def save(self, folder: Path | str) -> None:
        """Write `evaluation.json` at once.

        Raises:
            EvaluationError: it cannot be written, or an error is not finite.
        """
        path = Path(folder) / EVALUATION
        document = {
            "scene": self.scene,
            "objects": [{"id": number, **errors} for number, errors in self.objects.items()],
        }
        try:
            text = json.dumps(document, indent=1, allow_nan=False) + "\n"
        except ValueError as error:
            raise EvaluationError(f"{path}: the errors cannot be written as JSON ({error})") from error
        write_file(path, text.encode(), EvaluationError)


def evaluate_map(object_map: ObjectMap, truths: Mapping[int, GroundTruth], seed: int = 0) -> MapErrors:
    """The errors of every object of the map that has ground truth.

    An object that failed, or whose surface cannot be measured, counts as wrong. `seed` draws the points of the
    Chamfer distance.
    """
    judged = {
        entry.id: _errors(entry, truths[entry.id], seed) for entry in object_map.objects if entry.id in truths
    }
    return MapErrors(object_map.scene, judged)


def _errors(entry: MappedObject, truth: GroundTruth, seed: int) -> dict[str, Any]:
    if entry.vertices is None or entry.faces is None or entry.T_world_object is None or entry.scale is None:
        return dict(_WRONG)
    p_object = transformed_back(entry.T_world_object, entry.vertices) / entry.scale
    try:
        errors = evaluate_object(entry.T_world_object, entry.scale, p_object, entry.faces, truth, seed)
    except EvaluationError as error:
        log.warning("%s %d cannot be evaluated: %s", entry.category, entry.id, error)
        return dict(_WRONG)
    # NumPy's numbers are none of JSON's
    return {
        name: bool(value) if name == "pose_correct" else float(value)
        for name, value in asdict(errors).items()
    }
