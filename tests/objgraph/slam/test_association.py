"""Detections and mapped objects: who is matched, who is new, and that order does not matter."""

import logging
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from objgraph.slam.association import AssociationConfig, MappedCandidate, associate
from objgraph.slam.association.gate import Pair
from objgraph.slam.incremental.motion import joint_with_last_camera
from tests.objgraph.slam.association_cases import compare_all, drifted, mapped, pairs_of, row, seen, shifted
from tests.toys import toy_state


@pytest.mark.parametrize("drift", [-0.4, -0.2, 0.2, 0.4])
def test_twins_side_by_side_are_not_swapped_by_drift(drift):
    """With 0.4 m of drift each is nearer to the other's place than to its own."""
    states = row(2, 0.7)
    detections = seen(states)
    objects = [mapped(state, f"chair {i}", camera=0.2) for i, state in enumerate(states)]
    found = associate(detections, objects, T_world_camera=drifted(detections[0], drift, 0.0, 0.0))
    assert pairs_of(found) == [(0, 0), (1, 1)]
    assert found.new == found.dropped == ()
    assert all(match.mahalanobis < 3 and match.overlap > 0.8 for match in found.matches)


def test_without_an_uncertain_camera_drift_starts_new_objects():
    states = row(2, 0.7)
    detections = seen(states)
    objects = [mapped(state, sigma=0.01) for state in states]
    found = associate(detections, objects, T_world_camera=drifted(detections[0], 0.3, 0.0, 0.0))
    assert [entry.detection for entry in found.new] == [0, 1]
    assert all("is above 16.3" in entry.reason for entry in found.new)


@pytest.mark.parametrize("drift", [0.0, 0.25])
def test_a_new_chair_between_two_mapped_ones_is_started(drift, caplog):
    states = row(3, 0.7)
    detections = seen(states)
    objects = [mapped(state, name, camera=0.15) for state, name in zip(states[::2], "AB", strict=True)]
    with caplog.at_level(logging.INFO, "objgraph.slam.association"):
        found = associate(detections, objects, T_world_camera=drifted(detections[0], drift, 0.0, 0.0))
    assert pairs_of(found) == [(0, 0), (2, 1)]
    assert [entry.detection for entry in found.new] == [1]
    assert [record.getMessage() for record in caplog.records] == [
        entry.reason for entry in (*found.matches, *found.new)
    ]
    assert "detection 1 (chair) is new: " in found.new[0].reason


def test_a_match_tells_where_the_camera_is_for_the_others():
    """By itself the chair that is not mapped could be the one a step further on; the one beside it says not."""
    mapped_here, unknown, mapped_there = (shifted(toy_state(0.0), x, 0.0, 0.0) for x in (0.0, 0.9, 1.5))
    objects = [mapped(mapped_here, "here", camera=0.3), mapped(mapped_there, "there", camera=0.3)]
    detections = seen([mapped_here, unknown])
    assert pairs_of(associate(detections[1:], objects)) == [(0, 1)]
    found = associate(detections, objects)
    assert pairs_of(found) == [(0, 0)]
    assert "there is less likely than a new object" in found.new[0].reason


def test_a_turned_camera_is_put_right_before_overlap_is_judged():
    states = row(3, 0.8)
    detections = seen(states)
    turned = detections[0].view.T_world_camera.retract(np.array([0.1, -0.22, 0.1, 0.0, 0.0, 0.0]))
    variances = np.repeat([0.01, 0.15, 0.03], [13, 3, 3]) ** 2
    objects = [replace(mapped(state), covariance=lambda: np.diag(variances)) for state in states]
    config = AssociationConfig(distance=0.03)
    found = associate(detections, objects, config, T_world_camera=turned)
    assert pairs_of(found) == [(0, 0), (1, 1), (2, 2)]
    pairs = [
        Pair(detection.view, turned, entry, np.diag(variances))
        for detection, entry in zip(detections, objects, strict=True)
    ]
    by_itself = [fit.overlap for fit in compare_all(pairs, config)]
    assert max(by_itself) < 0.7
    assert min(match.overlap for match in found.matches) > 0.8


@pytest.mark.parametrize("common", [1e-3, 0.1, 1.0])
def test_what_a_correction_explains_is_counted_once_where_the_object_errs_with_the_camera(common):
    """Far from its anchor a map and its camera are off by the same: that says nothing of where one is from the other."""
    state = toy_state(0.0)
    (detection,) = seen([state])
    from_object = detection.view.T_world_camera.between(state.T_world_object).AdjointMap()
    own = np.diag(np.repeat([1e-3, common, 1e-2, 0.1], [3, 3, 3, len(state.code)]) ** 2)
    carry = np.zeros((len(own) + 6, len(own)))
    carry[: len(own)], carry[len(own) :, :6] = np.eye(len(own)), from_object
    joint = carry @ own @ carry.T
    joint[-6:, -6:] += np.diag(np.repeat([0.01, 0.1], 3) ** 2)
    entry = replace(mapped(state), covariance=lambda: joint)
    (match,) = associate([detection], [entry], T_world_camera=drifted(detection, 0.25, 0.0, 0.0)).matches
    # 25 cm in the two directions that tell, of which 10 cm are the camera's against the object
    assert match.mahalanobis == pytest.approx(2.43, abs=0.1)


@pytest.mark.parametrize("drift", [0.3, 0.45, 0.55, 0.65])
def test_what_waits_hangs_on_the_camera_that_saw_it_and_closes_no_loop_alone(drift):
    """A chair of the map, and one that was placed by cameras which had drifted as this one has."""
    there, waits = row(2, 1.6)
    detections = seen([there, waits])
    camera = drifted(detections[0], drift, 0.0, 0.0)
    moved = shifted(waits, drift, 0.0, 0.0)
    far, near = (np.diag(np.repeat([0.05 * metres, metres], 3) ** 2) for metres in (0.3, 0.05))
    own = np.asarray(mapped(waits, sigma=0.01).covariance())
    hanging = joint_with_last_camera(own, moved.T_world_object.between(camera), np.tile(far, (2, 2)))
    hanging[-6:, -6:] += near
    known = np.asarray(mapped(there, sigma=0.01, camera=0.3).covariance())
    known[-6:, -6:] = far + near
    objects = [replace(mapped(there, "there"), covariance=lambda: known)]
    objects.append(replace(mapped(moved, "waits"), covariance=lambda: hanging))
    assert pairs_of(associate(detections, objects, T_world_camera=camera)) == [(0, 0), (1, 1)]


def test_two_detections_do_not_share_an_object():
    (detection,) = seen([toy_state()])
    found = associate([detection, detection], [mapped(toy_state())])
    assert len(found.matches) == len(found.new) == 1
    assert "is detection" in found.new[0].reason


def test_a_vague_object_does_not_take_what_a_certain_one_explains():
    state = toy_state()
    objects = [
        mapped(shifted(state, 0.25, 0.0, 0.0), "vague", sigma=0.4),
        mapped(shifted(state, 0.04, 0.0, 0.0)),
    ]
    assert pairs_of(associate(seen([state]), objects)) == [(0, 1)]
    hopeless = replace(objects[0], covariance=lambda: np.diag([4.0] * 13))
    (new,) = associate(seen([state]), [hopeless]).new
    assert "less likely than a new" in new.reason


def test_categories_must_agree_up_to_their_names():
    state = toy_state()
    entry = mapped(state, "chair 7", category="Chair")
    assert pairs_of(associate(seen([state], category="office chair"), [entry])) == [(0, 0)]
    (new,) = associate(seen([state], category="table"), [entry]).new
    assert "chair 7, a Chair, is 0.00 m away" in new.reason


def test_covariances_are_asked_for_near_the_detections_alone():
    state, asked = toy_state(), []

    def entry(i: int) -> MappedCandidate:
        near = mapped(shifted(state, 3.0 * i, 0.0, 0.0), f"chair {i}")
        return replace(near, covariance=lambda: asked.append(i) or near.covariance())

    found = associate(seen([state]) * 2, [entry(i) for i in range(1000)])
    assert pairs_of(found)[0][1] == 0
    assert asked == [0]


@pytest.fixture(scope="module")
def scene():
    states = [shifted(toy_state(0.3 * i), 0.75 * i, 0.2 * (i % 2), 0.0) for i in range(4)]
    objects = [mapped(state, f"chair {i}", camera=0.1) for i, state in enumerate(states[:3])]
    return seen(states), [*objects, mapped(shifted(states[0], 0.05, 0.0, 0.0), "twin", sigma=0.1)]


@settings(max_examples=8)
@given(st.permutations(range(4)), st.permutations(range(4)))
def test_order_does_not_matter(scene, detections, objects):
    first = associate(*scene)
    found = associate([scene[0][i] for i in detections], [scene[1][j] for j in objects])
    assert {(detections[i], objects[j]) for i, j in pairs_of(found)} == set(pairs_of(first))
    assert {detections[new.detection] for new in found.new} == {new.detection for new in first.new} == {3}
