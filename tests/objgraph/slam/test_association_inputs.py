"""Association of what is broken or missing: left out, or an error that names it."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest

from factors.errors import FactorError
from objgraph.errors import ObservationError, SolveError
from objgraph.slam.association import Detection, associate, duplicates
from tests.objgraph.slam.association_cases import mapped, pairs_of, seen, shifted
from tests.toys import toy_state


def test_an_object_whose_covariance_cannot_be_had_is_left_out(caplog):
    def undetermined():
        raise SolveError("the graph does not determine o0")

    state = toy_state()
    good = mapped(state, "good")
    for bad in (
        replace(good, covariance=undetermined),
        replace(good, covariance=lambda: np.full((13, 13), np.nan)),
        replace(good, state=replace(state, log_scale=np.full(3, np.nan))),
    ):
        caplog.clear()
        assert pairs_of(associate(seen([state]), [replace(bad, name="bad"), good])) == [(0, 1)]
        assert "bad is left out" in caplog.text


def test_a_covariance_or_code_of_another_length_is_an_error_that_names_the_object():
    state = toy_state()
    with pytest.raises(FactorError, match=r"chair: a covariance of shape \(9, 9\), where 13"):
        associate(seen([state]), [replace(mapped(state), covariance=lambda: np.eye(9))])
    with pytest.raises(FactorError, match="chair: a code of length 7, but the decoder takes 4"):
        associate(seen([state]), [mapped(replace(state, code=np.zeros(7)))])


def test_nothing_seen_or_nothing_mapped():
    assert pairs_of(associate([], [])) == []
    assert associate([], [mapped(toy_state())]).new == ()
    (new,) = associate(seen([toy_state()]), []).new
    assert new.reason.endswith("nothing is mapped")
    assert duplicates([]) == duplicates([mapped(toy_state())]) == ()


def with_points(detection: Detection, points, sigma) -> Detection:
    return replace(detection, view=replace(detection.view, points_camera=points, points_sigma=sigma))


def test_points_that_are_not_finite_are_left_out():
    (detection,) = seen([toy_state()])
    points, sigma = detection.view.points_camera.copy(), detection.view.points_sigma.copy()
    points[::2], sigma[1::4] = np.nan, np.inf
    entry = mapped(toy_state())
    assert pairs_of(associate([with_points(detection, points, sigma)], [entry])) == [(0, 0)]
    nothing = with_points(detection, np.full_like(points, np.nan), sigma)
    found = associate([nothing, detection], [entry])
    assert pairs_of(found) == [(1, 0)]
    assert [entry.detection for entry in found.dropped] == [0]
    assert "no point of it is finite" in found.dropped[0].reason


def test_a_single_point_may_be_matched_but_starts_nothing():
    (detection,) = seen([toy_state()])
    one = with_points(detection, detection.view.points_camera[:1], detection.view.points_sigma[:1])
    assert pairs_of(associate([one], [mapped(toy_state())])) == [(0, 0)]
    found = associate([one], [mapped(shifted(toy_state(), 4.0, 0.0, 0.0))])
    assert found.new == found.matches == ()
    assert "1 points start no object" in found.dropped[0].reason


def test_a_camera_that_is_nowhere_is_an_error_that_names_the_frame():
    (detection,) = seen([toy_state()])
    T = gtsam.Pose3(gtsam.Rot3(), np.full(3, np.nan))
    with pytest.raises(ObservationError, match="frame 0: the camera pose is not finite"):
        associate([detection], [], T_world_camera=T)
