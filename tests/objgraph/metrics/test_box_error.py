"""Errors of a box in the coordinates of its covariance."""

import gtsam
import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

from objgraph.covariance.box import BOX_AXES, BoxPose
from objgraph.covariance.labelled import LabelledCovariance
from objgraph.datasets.ground_truth import GroundTruth
from objgraph.metrics.box_error import box_error, corners_m

COVARIANCE = LabelledCovariance(np.eye(9), BOX_AXES, "marginals")
EXTENTS = np.array([0.6, 0.9, 0.5])


def truth(pose: gtsam.Pose3, symmetry: int = 1, offset=(0.0, 0.0, 0.0)) -> GroundTruth:
    """A box whose mesh may lie off its origin."""
    box = trimesh.creation.box(EXTENTS / 1.2)
    vertices = np.asarray(box.vertices) + offset
    return GroundTruth(pose.matrix(), np.full(3, 1.2), vertices, np.asarray(box.faces), symmetry)


def moved(pose: gtsam.Pose3, tangent: np.ndarray) -> tuple[gtsam.Pose3, np.ndarray]:
    rotation = pose.rotation().compose(gtsam.Rot3.Expmap(tangent[:3]))
    return gtsam.Pose3(rotation, pose.transformFrom(tangent[3:6])), EXTENTS * np.exp(tangent[6:])


def some_pose(seed: int) -> gtsam.Pose3:
    rng = np.random.default_rng(seed)
    return gtsam.Pose3(gtsam.Rot3.Expmap(rng.normal(size=3)), rng.normal(size=3))


@given(st.integers(0, 1000), st.integers(1, 6), st.integers(0, 5))
def test_the_error_is_the_tangent_that_leads_to_the_truth(seed, symmetry, turns):
    """Whatever symmetric turn the estimate stands in; extents change places at a quarter turn."""
    tangent = np.random.default_rng(seed).uniform(-0.15, 0.15, 9)
    estimate = some_pose(seed)
    T, extents = moved(estimate, tangent)
    turn = 2 * np.pi * (turns % symmetry) / symmetry
    true = gtsam.Pose3(T.rotation().compose(gtsam.Rot3.Ry(-turn)), T.translation())
    swapped = symmetry == 4 and turns % 4 in (1, 3)
    given_extents = extents[[2, 1, 0]] if swapped else extents
    mesh = trimesh.creation.box(given_extents)
    ground = GroundTruth(
        true.matrix(), np.ones(3), np.asarray(mesh.vertices), np.asarray(mesh.faces), symmetry
    )
    found = box_error(BoxPose(estimate, EXTENTS, COVARIANCE), ground)
    np.testing.assert_allclose(found.tangent, tangent, atol=1e-9)


def test_the_truths_centre_is_its_boxs():
    pose = some_pose(1)
    found = box_error(BoxPose(pose, EXTENTS, COVARIANCE), truth(pose, offset=(0.1, 0.0, -0.05)))
    np.testing.assert_allclose(found.tangent, [0, 0, 0, 0.12, 0, -0.06, 0, 0, 0], atol=1e-12)


@given(st.integers(0, 1000))
def test_corners_are_as_far_apart_as_those_of_the_two_boxes(seed):
    estimate, tangent = some_pose(seed), np.random.default_rng(seed).uniform(-0.3, 0.3, 9)
    T, extents = moved(estimate, tangent)
    mesh = trimesh.creation.box(extents)
    ground = GroundTruth(T.matrix(), np.ones(3), np.asarray(mesh.vertices), np.asarray(mesh.faces), 1)
    box = BoxPose(estimate, EXTENTS, COVARIANCE)
    signs = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
    apart = [
        np.linalg.norm(estimate.transformFrom(sign * EXTENTS) - T.transformFrom(sign * extents))
        for sign in signs
    ]
    assert corners_m(box, box_error(box, ground)) == pytest.approx(np.mean(apart))


def test_a_round_object_has_no_heading():
    pose = some_pose(2)
    turned = gtsam.Pose3(pose.rotation().compose(gtsam.Rot3.Ry(1.0)), pose.translation())
    found = box_error(BoxPose(turned, EXTENTS, COVARIANCE), truth(pose, 0))
    np.testing.assert_allclose(found.tangent[:6], 0.0, atol=1e-9)
