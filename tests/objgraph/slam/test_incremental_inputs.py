"""What an incremental map cannot use is named, and leaves it as it was."""

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import X

from objgraph.errors import ConfigError, ObservationError, SolveError
from objgraph.observation.frames import Instance
from objgraph.slam import IncrementalObjectGraph, ObjectFrontEnd
from tests.toys import toy_frame, toy_prior, toy_state

UP = np.array([0.0, 0.0, 1.0])
FRAME = toy_frame([toy_state()], 0.3)
OWN = gtsam.Values()
OWN.insert(X(0), gtsam.Pose3())


@pytest.mark.parametrize(
    ("given", "error", "message"),
    [
        ({"frame": None}, ObservationError, "frame must be of type Frame"),
        ({"detections": [1]}, ObservationError, r"frame 0: detections\[0\] must be of type Instance"),
        (
            {"detections": [Instance(2, "chair"), Instance(1, "chair"), Instance(1, "table")]},
            ObservationError,
            "frame 0: detections name object 1 2 times",
        ),
        ({"camera": "x0"}, SolveError, "frame 0: camera must be a key"),
        ({"factors": [None]}, SolveError, r"frame 0: factors\[0\] must be of type NonlinearFactor"),
        ({"values": {}}, SolveError, "frame 0: values must be of type Values"),
        ({"values": OWN}, SolveError, "frame 0: x0, the frame's own pose, must not be among `values`"),
    ],
)
def test_an_update_that_is_none_changes_nothing(given, error, message):
    objects = IncrementalObjectGraph(UP)
    with pytest.raises(error, match=message):
        objects.update(**({"frame": FRAME, "detections": []} | given))
    assert not objects.cameras
    assert objects.estimate().size() == 0


def test_a_map_without_frames_can_be_optimised_and_has_no_cameras():
    objects = IncrementalObjectGraph(UP)
    objects.optimize()
    assert objects.estimate().size() == 0
    with pytest.raises(SolveError, match="x7: not in the incremental system"):
        objects.pose(X(7))
    objects.update(FRAME, [])
    objects.optimize()
    assert objects.pose(X(0)).equals(gtsam.Pose3(FRAME.T_world_camera), 1e-6)


def test_a_category_of_which_nothing_is_known_is_left_out_with_the_reason():
    objects = IncrementalObjectGraph(UP, find_prior=lambda _: None)  # type: ignore[arg-type]
    report = objects.update(FRAME, [Instance(1, "chair")])
    assert "a prior must be of type ShapePrior, not NoneType" in report.reasons
    objects = IncrementalObjectGraph(UP, find_prior={"table": toy_prior()}.__getitem__)
    report = objects.update(FRAME, [Instance(1, "chair")])
    assert report.reasons == ("find_prior('chair') failed: KeyError('chair')",)


@pytest.mark.parametrize(
    ("given", "error"),
    [
        ({"up_world": np.zeros(3)}, ObservationError),
        ({"config": 3}, ConfigError),
        ({"find_prior": "chair"}, ConfigError),
        ({"body_T_camera": np.eye(4)}, ObservationError),
    ],
)
def test_what_makes_no_map_is_refused(given, error):
    with pytest.raises(error):
        IncrementalObjectGraph(**({"up_world": UP} | given))
    with pytest.raises(error):
        ObjectFrontEnd(**({"smoother": gtsam.ISAM2(), "up_world": UP} | given))


def test_what_is_no_smoother_or_no_camera_of_it_is_named():
    with pytest.raises(ConfigError, match="is no smoother"):
        ObjectFrontEnd(None, UP)  # type: ignore[arg-type]
    front_end = ObjectFrontEnd(gtsam.ISAM2(), UP, find_prior=lambda _: toy_prior())
    with pytest.raises(SolveError, match="x0"):
        front_end.step(FRAME, [], camera=X(0))
    with pytest.raises(ObservationError, match="name object 1 2 times"):
        front_end.step(FRAME, [Instance(1, "chair")] * 2, camera=X(0))
