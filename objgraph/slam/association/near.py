"""The first, cheap gate of association: usable points, and which objects of a category stand near them."""

import logging
from collections.abc import Mapping, Sequence
from dataclasses import replace

import gtsam
import numpy as np
from jaxtyping import Float

from objgraph.errors import ObservationError
from objgraph.observation.sampling import ObjectView
from objgraph.priors.categories import category_of
from objgraph.slam.association.types import AssociationConfig, Detection, MappedCandidate

_LOG = logging.getLogger(__name__)


def cleaned(view: ObjectView) -> ObjectView | None:
    """The view without points that are not finite or have no positive noise; None where nothing is left."""
    sigma = view.points_sigma
    good = np.isfinite(view.points_camera).all(axis=1) & np.isfinite(sigma) & (sigma > 0)
    if not good.any():
        return None
    if not good.all():
        _LOG.info(
            "frame %s: %d of %d points of a detection are left out, not finite or without a noise",
            view.frame,
            (~good).sum(),
            len(good),
        )
        view = replace(view, points_camera=view.points_camera[good], points_sigma=sigma[good])
    return view


def camera_of(view: ObjectView, T_world_camera: gtsam.Pose3 | None) -> gtsam.Pose3:
    """The given pose or else the view's own; raises ObservationError where it is not finite."""
    T = view.T_world_camera if T_world_camera is None else T_world_camera
    if not np.isfinite(T.matrix()).all():
        raise ObservationError(f"frame {view.frame}: the camera pose is not finite; leave the frame out")
    return T


def distances(
    views: Mapping[int, ObjectView],
    cameras: Mapping[int, gtsam.Pose3],
    count: int,
    objects: Sequence[MappedCandidate],
) -> Float[np.ndarray, "d o"]:
    """Metres from the middle of each of `count` detections to each object's bounding sphere, negative inside it.

    Infinite where a detection is not among `views` or an object's state is not finite.
    """
    distance = np.full((count, len(objects)), np.inf)
    usable = [j for j, entry in enumerate(objects) if entry.is_finite]
    for j in set(range(len(objects))) - set(usable):
        _LOG.warning("%s is left out of the association: its state is not finite", objects[j].name)
    if not usable or not views:
        return distance
    centres = np.array([objects[j].state.T_world_object.translation() for j in usable])
    radii = np.array([objects[j].radius for j in usable])
    middles = np.array(
        [cameras[i].transformFrom(np.median(view.points_camera, axis=0)) for i, view in views.items()]
    )
    apart = np.linalg.norm(middles[:, None] - centres, axis=2) - radii
    distance[np.ix_(list(views), usable)] = apart
    return distance


def near_pairs(
    distance: Float[np.ndarray, "d o"],
    detections: Sequence[Detection],
    objects: Sequence[MappedCandidate],
    config: AssociationConfig,
) -> list[tuple[int, int]]:
    """Detections and the nearest objects of their category within `reach`."""
    if not distance.size:
        return []
    wanted = np.array([category_of(detection.category) for detection in detections])
    mapped = np.array([category_of(entry.category) for entry in objects])
    apart = np.where(wanted[:, None] == mapped, distance, np.inf)
    order = np.argsort(apart, axis=1, kind="stable")[:, : config.candidates]
    return [(i, int(j)) for i, row in enumerate(order) for j in row if apart[i, j] <= config.reach]
