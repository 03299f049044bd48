"""Each number of the evidence by a case in which it is known."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from trimesh.remesh import subdivide_to_size

from objgraph.covariance.heading_modes import HeadingModes
from objgraph.covariance.labelled import ObjectCovariance
from objgraph.errors import CovarianceError
from objgraph.estimate.task import Estimate, EstimationTask
from objgraph.observation.sampling import SamplingConfig, observe
from objgraph.trust.evidence import Evidence, evidence_of
from tests.objgraph.trust.calibrations import EVIDENCE
from tests.toys import toy_frame, toy_mesh, toy_prior, toy_state

UP = np.array([0.0, 0.0, 1.0])
STATE = toy_state(1.0)
SAMPLING = SamplingConfig(points=200, hits=80, free=120)
AROUND = (0.3, 2.4, 4.5)


def found(state=STATE, azimuths=AROUND, turns=None, **changes) -> tuple[Evidence, np.ndarray]:
    """Of an estimate, where `STATE` was seen."""
    views = tuple(observe(toy_frame([STATE], azimuth, f"f{azimuth}"), 1, SAMPLING) for azimuth in azimuths)
    task = EstimationTask("chair 1", toy_prior(), (STATE,), views, UP, **changes)
    covariance = ObjectCovariance.diagonal(np.full(13, 1e-4), "marginals")
    mesh = toy_mesh(state.code)
    vertices = subdivide_to_size(mesh.vertices, mesh.faces, 0.05)[0]
    return evidence_of(task, Estimate(state, covariance, 2.0, 1.0, 1, 1, turns), state.to_world(vertices))


def moved(metres: float):
    T = STATE.T_world_object
    return replace(STATE, T_world_object=gtsam.Pose3(T.rotation(), T.translation() + [metres, 0, 0]))


def test_a_good_estimate_has_nothing_against_it():
    evidence, _ = found()
    assert evidence.off < 0.1
    assert evidence.through < 0.01
    assert evidence.moved == 0.0
    assert (evidence.heading, evidence.guess) == (1.0, 1.0)


def test_more_views_see_more():
    one, three = found(azimuths=AROUND[:1])[0], found()[0]
    assert 0 < one.seen < three.seen <= 1


def test_an_estimate_beside_what_is_seen_is_off_and_stands_in_free_space():
    good, bad = found()[0], found(moved(0.25))[0]
    assert bad.off > good.off + 0.3
    assert bad.through > good.through + 0.005
    assert bad.seen < good.seen


def test_who_saw_no_point_has_seen_nothing():
    view = observe(toy_frame([STATE], 0.3), 1, SAMPLING)
    blind = replace(view, points_camera=np.full((5, 3), np.nan), points_sigma=np.ones(5))
    task = EstimationTask("chair 1", toy_prior(), (STATE,), (blind,), UP)
    covariance = ObjectCovariance.diagonal(np.full(13, 1e-4), "marginals")
    vertices = STATE.to_world(np.asarray(toy_mesh(STATE.code).vertices))
    evidence, sides = evidence_of(task, Estimate(STATE, covariance, 2.0, 1.0, 1, 1), vertices)
    assert (evidence.seen, evidence.off) == (0.0, 0.0)
    assert not sides.any()


def test_how_far_it_went_is_over_its_diagonal():
    extents = np.ptp(np.asarray(toy_mesh(STATE.code).vertices), axis=0) * STATE.scale
    assert found(moved(0.25))[0].moved == pytest.approx(0.25 / np.linalg.norm(extents), rel=1e-6)


def test_headings_and_the_first_guess_are_taken_as_they_are():
    turns = HeadingModes(np.array([0.6, 0.4, 0.0, 0.0]))
    evidence, _ = found(turns=turns, chances=(0.7,))
    assert (evidence.heading, evidence.guess) == (0.6, 0.7)


def test_size_is_in_the_category_s_deviations():
    prior, larger = toy_prior(), replace(STATE, log_scale=STATE.log_scale + 0.5)
    sizes = [
        np.log(
            np.linalg.norm(np.ptp(np.asarray(toy_mesh(s.code).vertices), axis=0) * s.scale) / prior.size_mean
        )
        for s in (STATE, larger)
    ]
    for state, size in zip((STATE, larger), sizes, strict=True):
        assert found(state)[0].size == pytest.approx(abs(size) / prior.size_log_sigma, rel=1e-6)


def test_the_side_away_from_the_camera_is_not_seen():
    evidence, sides = found(azimuths=AROUND[1:2])
    assert sides.shape == (3, 2)
    assert sides.min() < 0.3
    assert sides.max() > 0.8
    assert sides.min() < evidence.seen < sides.max()


@pytest.mark.parametrize("value", [float("nan"), float("inf"), "much", None])
def test_evidence_that_is_no_number_is_refused(value):
    with pytest.raises(CovarianceError, match="the evidence 'seen'"):
        replace(EVIDENCE, seen=value)
