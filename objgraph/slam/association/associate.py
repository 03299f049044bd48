"""Which mapped objects the detections of a frame are, which are new, and which mapped objects are one and the same.

Works upon states and covariances alone: no graph, no images. `objgraph.slam.association.gate` says what is tested.
"""

import logging
from collections.abc import Sequence

import gtsam
import numpy as np

from objgraph.priors.categories import category_of
from objgraph.slam.association.gate import Fit
from objgraph.slam.association.near import camera_of, cleaned
from objgraph.slam.association.rounds import Round, Rounds
from objgraph.slam.association.types import (
    Association,
    AssociationConfig,
    Detection,
    MappedCandidate,
    Match,
    Unmatched,
)

_LOG = logging.getLogger(__name__)


def associate(
    detections: Sequence[Detection],
    objects: Sequence[MappedCandidate],
    config: AssociationConfig | None = None,
    T_world_camera: gtsam.Pose3 | None = None,
) -> Association:
    """Tell for the detections of one frame which mapped objects they are.

    A pair must be of one category, near each other, pass the Mahalanobis gate under the joint covariance of object and
    camera, overlap, and leave free what is seen to be free. Among the pairs that do, the assignment of least cost is
    taken (`objgraph.slam.association.joint`), in which starting a new object is always possible; where it says that the camera
    stands noticeably elsewhere, all is done once more from there. The camera's estimate is `T_world_camera`, or
    else each view's own. What is decided of each detection is logged at INFO, one line each.

    Raises:
        ObservationError: the camera's pose is not finite; the message names the frame.
        FactorError: a covariance has another shape than the object's code asks for, or a code than its decoder's.
    """
    config = config or AssociationConfig()
    usable = {i: cleaned(detection.view) for i, detection in enumerate(detections)}
    views = {i: view.thinned(config.points, config.rays) for i, view in usable.items() if view is not None}
    cameras = {i: camera_of(view, T_world_camera) for i, view in views.items()}
    found = Rounds(detections, views, objects, config).run(cameras)
    matches, new, dropped = [], [], []
    for i, detection in enumerate(detections):
        label = f"detection {i} ({detection.category})"
        view = usable[i]
        if view is None:
            dropped.append(
                Unmatched(i, f"{label} is dropped: no point of it is finite with a positive noise")
            )
        elif i in found.chosen:
            j = found.chosen[i]
            matches.append(_match(label, i, j, objects, found.fits[i, j]))
        else:
            why = _why_unmatched(i, found, detections, objects)
            if (count := len(view.points_camera)) < config.start_points:
                dropped.append(Unmatched(i, f"{label} is dropped, {count} points start no object: {why}"))
            else:
                new.append(Unmatched(i, f"{label} is new: {why}"))
    for entry in (*matches, *new, *dropped):
        _LOG.info("%s", entry.reason)
    return Association(tuple(matches), tuple(new), tuple(dropped))


def _match(label: str, i: int, j: int, objects: Sequence[MappedCandidate], fit: Fit) -> Match:
    reason = f"{label} is {objects[j].name}: {fit.describe()}"
    return Match(i, j, reason, float(np.sqrt(fit.squared)), fit.overlap)


def _why_unmatched(
    i: int, found: Round, detections: Sequence[Detection], objects: Sequence[MappedCandidate]
) -> str:
    """What was nearest to being this detection's object, and why it is not."""
    compared = sorted((fit.squared, j) for (k, j), fit in found.fits.items() if k == i)
    for _, j in compared:
        if found.refusals[i, j] is None:
            taken = [k for k, object_of_k in found.chosen.items() if object_of_k == j]
            why = f"is detection {taken[0]}" if taken else "is less likely than a new object"
            return f"{objects[j].name} {why} ({found.fits[i, j].describe()})"
    if compared:
        j = compared[0][1]
        return f"{objects[j].name} is refused, {found.refusals[i, j]}"
    distance = found.distance[i]
    if not np.isfinite(distance).any():
        return "nothing is mapped"
    j = int(np.argmin(distance))
    same = category_of(objects[j].category) == category_of(detections[i].category)
    kind = "" if same else f", a {objects[j].category}"
    return f"the nearest, {objects[j].name}{kind}, is {max(distance[j], 0.0):.2f} m away"
