"""The comparison of a frame's detections with the map, once more where it shows that the camera stands elsewhere."""

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import gtsam
import numpy as np
from jaxtyping import Float

from objgraph.errors import SolveError
from objgraph.observation.sampling import ObjectView
from objgraph.slam.association.gate import Fit, Pair, PairIndex, compare
from objgraph.slam.association.joint import assign, camera_error
from objgraph.slam.association.near import distances, near_pairs
from objgraph.slam.association.types import AssociationConfig, Detection, MappedCandidate

_LOG = logging.getLogger(__name__)

_LOOSE = 0.5
"""Of the overlap that a match needs, what is enough to tell where the camera is: as it was, it may be turned."""


@dataclass(frozen=True)
class Round:
    """What was compared and chosen."""

    distance: Float[np.ndarray, "d o"]
    """Metres from each detection to each object's bounding sphere."""
    fits: Mapping[PairIndex, Fit]
    refusals: Mapping[PairIndex, str | None]
    chosen: Mapping[int, int]
    """The object of each detection that has one."""


class Rounds:
    """One frame's detections and the map; an object's covariance is asked for once."""

    def __init__(
        self,
        detections: Sequence[Detection],
        views: Mapping[int, ObjectView],
        objects: Sequence[MappedCandidate],
        config: AssociationConfig,
    ) -> None:
        self._detections = detections
        self._views = views
        self._objects = objects
        self._config = config
        self._covariances: dict[int, Float[np.ndarray, "d d"] | None] = {}

    def run(self, cameras: Mapping[int, gtsam.Pose3]) -> Round:
        """Compare with the cameras as given and, where the matches move them noticeably, as they say."""
        config = self._config
        near = distances(self._views, cameras, len(self._detections), self._objects)
        pairs = self._pairs(near, cameras)
        loose = replace(config, overlap=_LOOSE * config.overlap)
        fits = compare(pairs, loose)
        moved = self._moved(cameras, pairs, fits, loose)
        if moved is None:
            return _judged(near, fits, config)
        at, error = moved
        near = distances(self._views, at, len(self._detections), self._objects)
        pairs |= self._pairs(near, cameras)
        pairs = {(i, j): pair.corrected(at[i], error) for (i, j), pair in pairs.items()}
        return _judged(near, compare(pairs, config), config)

    def _moved(
        self,
        cameras: Mapping[int, gtsam.Pose3],
        pairs: Mapping[PairIndex, Pair],
        fits: Mapping[PairIndex, Fit],
        loose: AssociationConfig,
    ) -> tuple[dict[int, gtsam.Pose3], Float[np.ndarray, "6"]] | None:
        """Where the likeliest matches put the cameras, and by which whitened error; None where that is no matter."""
        chosen = list(_judged(np.empty((0, 0)), fits, loose).chosen.items())
        roots = [pairs[pair].camera_root for pair in chosen if pairs[pair].has_camera]
        if not roots:
            return None
        error = camera_error(chosen, fits)
        moved = {i: T.retract(roots[0] @ error) for i, T in cameras.items()}
        middles = {i: np.median(view.points_camera, axis=0) for i, view in self._views.items()}
        shift = [moved[i].transformFrom(p) - cameras[i].transformFrom(p) for i, p in middles.items()]
        return (moved, error) if np.linalg.norm(shift, axis=1).max() > self._config.distance else None

    def _pairs(
        self,
        near: Float[np.ndarray, "d o"],
        cameras: Mapping[int, gtsam.Pose3],
    ) -> dict[PairIndex, Pair]:
        """What is worth a comparison."""
        pairs = {}
        for i, j in near_pairs(near, self._detections, self._objects, self._config):
            if (covariance := self._covariance(j)) is not None:
                pairs[i, j] = Pair(self._views[i], cameras[i], self._objects[j], covariance)
        return pairs

    def _covariance(self, j: int) -> Float[np.ndarray, "d d"] | None:
        if j not in self._covariances:
            try:
                self._covariances[j] = self._objects[j].checked_covariance()
            except SolveError as error:
                _LOG.warning("%s is left out of the association: %s", self._objects[j].name, error)
                self._covariances[j] = None
        return self._covariances[j]


def _judged(
    distance: Float[np.ndarray, "d o"], fits: Mapping[PairIndex, Fit], config: AssociationConfig
) -> Round:
    refusals = {pair: fit.refusal(config) for pair, fit in fits.items()}
    chosen = assign({pair: fit for pair, fit in fits.items() if refusals[pair] is None}, config)
    return Round(distance, fits, refusals, chosen)
