"""A map's entries: of either estimator, with surfaces, boxes and verdicts that say how well they are known."""

from dataclasses import replace
from typing import Any

import gtsam
import numpy as np
import pytest
from scipy.stats import chi2

from factors.state import ObjectState
from objgraph.covariance.box import box_pose
from objgraph.covariance.heading_modes import HeadingModes
from objgraph.covariance.labelled import ObjectCovariance
from objgraph.covariance.surface import surface_sigma
from objgraph.errors import SolveError
from objgraph.estimate import AdamConfig
from objgraph.estimate.task import Estimate, EstimationTask
from objgraph.estimate.terms import RaySteps
from objgraph.graph.builder import ObjectBuilder
from objgraph.graph.solve import solve
from objgraph.maps.entry import map_entry, with_trust
from objgraph.maps.object_map import ObjectMap
from objgraph.maps.pipeline import map_object
from objgraph.observation.frames import Instance
from objgraph.observation.sampling import observe
from objgraph.trust.evidence import evidence_of
from tests.objgraph.maps.test_pipeline import CONFIG, UP
from tests.objgraph.trust.calibrations import calibration
from tests.toys import toy_frame, toy_mesh, toy_prior, toy_state

ADAM = AdamConfig(iterations=40, points=100, rays=60, steps=RaySteps(samples=30))


@pytest.fixture(scope="module")
def by_estimator() -> dict[str, Any]:
    """One chair, mapped by either estimator and by both."""
    state = toy_state(1.0)
    views = [observe(toy_frame([state], a, seed=i), 1, CONFIG.sampling) for i, a in enumerate((0.3, 2.0))]
    found = {}
    for estimator in ("graph", "adam", "both"):
        config = replace(CONFIG, estimator=estimator, adam=ADAM)
        found[estimator] = map_object(Instance(1, "chair"), toy_prior(), views, UP, 0.0, config)
    return found


def test_both_estimators_stand_side_by_side(by_estimator):
    graph, adam, both = (by_estimator[name] for name in ("graph", "adam", "both"))
    assert (graph.estimator, graph.other) == ("graph", None)
    assert (adam.estimator, adam.other) == ("adam", None)
    assert both.estimator == "graph"
    assert both.other.estimator == "adam"
    for name in ("T_world_object", "scale", "code", "covariance", "code_sigma"):
        np.testing.assert_array_equal(getattr(both, name), getattr(graph, name))
        np.testing.assert_array_equal(getattr(both.other, name), getattr(adam, name))
        assert np.abs(getattr(graph, name) - getattr(adam, name)).max() > 1e-6
    assert (both.cost_initial, both.cost_final) == (graph.cost_initial, graph.cost_final)


@pytest.mark.parametrize("name", ["adam", "both"])
def test_an_estimate_by_gradients_is_a_whole_entry(by_estimator, name, tmp_path):
    entry = by_estimator[name]
    ObjectMap("chair", (entry,), UP).save(tmp_path)
    (again,) = ObjectMap.load(tmp_path).objects
    assert (again.estimator, again.other) == (entry.estimator, entry.other)
    np.testing.assert_array_equal(again.covariance, entry.covariance)
    truth = toy_state(1.0)
    for found in (entry, entry.other) if entry.other else (entry,):
        between = truth.T_world_object.between(gtsam.Pose3(found.T_world_object))
        assert np.linalg.norm(gtsam.Rot3.Logmap(between.rotation())) < np.radians(10)
        assert np.linalg.norm(between.translation()) < 0.1
    estimate = entry.other or entry
    np.testing.assert_array_equal(estimate.covariance, np.diag(np.diag(estimate.covariance)))
    # the mesh is that of the entry's own estimate
    T = entry.T_world_object
    p_object = (entry.vertices - T[:3, 3]) @ T[:3, :3] / entry.scale
    np.testing.assert_allclose(np.ptp(p_object, axis=0), toy_mesh(entry.code.copy()).extents, atol=0.03)
    assert np.isfinite(entry.vertex_sigma).all()
    assert entry.cost_final <= entry.cost_initial
    if name == "adam":  # the graph's own start may already be the best place it knows
        assert entry.cost_final < entry.cost_initial


def test_an_estimate_without_covariance_cannot_be_mapped():
    state = toy_state(1.0)
    views = [observe(toy_frame([state], 0.3), 1, CONFIG.sampling)]
    certain = replace(CONFIG, estimator="adam", adam=replace(ADAM, iterations=2, uncertainty=False))
    with pytest.raises(SolveError, match=r"chair 3: .*no covariance"):
        map_object(Instance(3, "chair"), toy_prior(), views, UP, 0.0, certain)


def task_of(prior) -> EstimationTask:
    """One view of a toy where it is."""
    state = toy_state(1.0)
    views = (observe(toy_frame([state], 0.3), 1, CONFIG.sampling),)
    return EstimationTask("chair 3", prior, (state,), views, UP)


def test_surfaces_of_the_map_are_as_uncertain_as_the_prior_says():
    state, prior = toy_state(1.0), toy_prior()
    covariance = ObjectCovariance.diagonal(np.full(13, 1e-4), "marginals")
    estimate = Estimate(state, covariance, 2.0, 1.0, 1, 1)
    usual, wide = (
        map_entry(
            Instance(3, "chair"), replace(prior, surface_misfit=factor), estimate, task_of(prior).views, 24
        )
        for factor in (1.0, 4.0)
    )
    assert usual.vertices is not None
    assert usual.vertex_sigma is not None
    expected = surface_sigma(prior.decoder, state, covariance, state.to_object(usual.vertices))
    np.testing.assert_allclose(usual.vertex_sigma, expected, rtol=1e-4)
    assert wide.vertex_sigma is not None
    np.testing.assert_allclose(wide.vertex_sigma, 2 * expected, rtol=1e-4)
    # what is asked of the map later is the graph's own
    np.testing.assert_array_equal(wide.joint_covariance, covariance.matrix)


def test_the_box_has_the_calibrated_covariance_and_a_verdict_or_neither():
    state, prior = toy_state(1.0), replace(toy_prior(), category="chair")
    covariance = ObjectCovariance.diagonal(np.full(13, 1e-4), "marginals")
    turns = HeadingModes(np.array([0.7, 0.0, 0.3, 0.0]))
    estimate, task = Estimate(state, covariance, 2.0, 1.0, 1, 1, turns), task_of(prior)
    known = calibration(prior.digest)
    entry = map_entry(Instance(3, "chair"), prior, estimate, task.views, 24)
    assert entry.box_covariance is entry.trust is None
    found = with_trust(entry, task, estimate, known)
    assert found.vertices is not None
    evidence, sides = evidence_of(task, estimate, found.vertices)
    raw = box_pose(prior, state, covariance, state.to_object(found.vertices))
    expected = known.categories["chair"].box(evidence, raw, sides)
    assert found.box_covariance is not None
    assert found.box_centre is not None
    assert found.box_extents is not None
    matrix = expected.covariance.matrix + turns.second_moment(raw.extents)
    np.testing.assert_allclose(found.box_covariance, matrix, rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(found.box_centre, raw.T_world_box.translation(), atol=1e-9)
    np.testing.assert_allclose(found.box_extents, raw.extents)
    assert found.trust == known.categories["chair"].trust(evidence, known.digest)
    # the modes are without what they add to each other
    assert [mode.probability for mode in found.box_modes] == [0.7, 0.3]
    np.testing.assert_allclose(
        found.box_modes[0].box.covariance.matrix, expected.covariance.matrix, atol=1e-12
    )
    # the file's marginals stay as they are
    np.testing.assert_array_equal(found.covariance, covariance.rigid)
    by_adam = replace(estimate, covariance=ObjectCovariance.diagonal(np.full(13, 1e-4), "adam"))
    for other in (
        with_trust(entry, task, estimate, calibration("other weights")),
        with_trust(entry, task, by_adam, known),
    ):
        assert other.box_covariance is other.trust is None
        assert other.box_modes == ()


def test_the_covariance_of_many_chairs_covers_their_truth():
    """Chairs drawn from the prior, solved from near: the normalised squared error (9 dof) is about chi-square."""
    prior, count, total = toy_prior(), 10, 0.0
    rng = np.random.default_rng(0)
    for seed in range(count):
        code = rng.multivariate_normal(prior.code_mean, 0.5 * np.asarray(prior.code_covariance))
        size = np.log(prior.size_mean) + 0.1 * rng.normal()
        drawn = toy_state(rng.uniform(-np.pi, np.pi), code)
        log_scale = size + 0.05 * rng.normal(size=3)
        height = -toy_mesh(code).bounds[0, 1] * np.exp(log_scale[1])
        T = gtsam.Pose3(drawn.T_world_object.rotation(), np.array([0.3, 0.2, height]))
        truth = ObjectState(T, log_scale, code)
        views = [observe(toy_frame([truth], a, seed=seed), 1, CONFIG.sampling) for a in (0.3, 2.0)]
        start = truth.retract(np.concatenate([0.03 * rng.normal(size=9), -code]))
        single = ObjectBuilder(up_world=UP).alone(prior, start, views)
        solve([single], CONFIG.solver)
        found, covariance = single.state, single.marginals().rigid
        error = np.concatenate(
            [found.T_world_object.localCoordinates(truth.T_world_object), truth.log_scale - found.log_scale]
        )
        total += float(error @ np.linalg.solve(covariance, error))
    assert total / count / 9 < 3
    # nor so unsure of itself that nothing could ever contradict it
    assert total > chi2.ppf(1e-6, 9 * count) / 20
