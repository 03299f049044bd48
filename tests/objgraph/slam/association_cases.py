"""Mapped toy chairs, and detections of them."""

from dataclasses import replace

import gtsam
import numpy as np

from factors.state import ObjectState
from objgraph.observation.sampling import ObjectView, SamplingConfig, observe
from objgraph.slam.association import AssociationConfig, Detection, MappedCandidate
from objgraph.slam.association.gate import Fit, Pair, compare
from tests.toys import TOY_CODE, ToyDecoder, toy_frame, toy_state

CHAIR = ToyDecoder()
SAMPLING = SamplingConfig(points=120, hits=60, free=60)


def compare_all(pairs, config) -> list[Fit]:
    return list(compare({(i, i): pair for i, pair in enumerate(pairs)}, config).values())


def mapped(state: ObjectState, name="chair", *, sigma=0.03, camera=0.0, category="chair") -> MappedCandidate:
    """A toy chair known to `sigma` (metres, radians), with a camera known to `camera` where that is not 0."""
    variances = np.full(9 + TOY_CODE, sigma**2)
    variances[9:] = 0.1
    if camera:
        variances = np.append(variances, [(0.1 * camera) ** 2] * 3 + [camera**2] * 3)
    return MappedCandidate(name, category, CHAIR, state, lambda: np.diag(variances))


def shifted(state: ObjectState, *metres: float) -> ObjectState:
    T = state.T_world_object
    return replace(state, T_world_object=gtsam.Pose3(T.rotation(), T.translation() + np.array(metres)))


def chair_views(states, azimuth: float) -> list[ObjectView]:
    frame = toy_frame(states, azimuth)
    return [observe(frame, i + 1, SAMPLING) for i in range(len(states))]


def seen(states, azimuth=0.6, category="chair") -> list[Detection]:
    return [Detection(view, category) for view in chair_views(states, azimuth)]


def row(count: int, gap: float) -> list[ObjectState]:
    """Chairs of one shape side by side."""
    return [shifted(toy_state(0.0), gap * i, 0.0, 0.0) for i in range(count)]


def pairs_of(found) -> list[tuple[int, int]]:
    return [(match.detection, match.object) for match in found.matches]


def drifted(detection: Detection, *metres: float) -> gtsam.Pose3:
    T = detection.view.T_world_camera
    return gtsam.Pose3(T.rotation(), T.translation() + np.array(metres))


def compare_one(detection: Detection, entry: MappedCandidate) -> Fit:
    pair = Pair(detection.view, detection.view.T_world_camera, entry, entry.covariance())
    return compare_all([pair], AssociationConfig())[0]
