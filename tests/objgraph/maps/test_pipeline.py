"""From a scan to a map: chairs where they are, failures that say why, and no look at the ground truth."""

import json
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import gtsam
import numpy as np
import pytest
from scipy.spatial import KDTree
from scipy.stats import chi2
from trimesh.sample import sample_surface

from factors.state import ObjectState
from objgraph.bench.metrics.maps import ERROR_KEYS, evaluate_map
from objgraph.covariance.box import box_pose
from objgraph.covariance.heading_modes import HeadingModes
from objgraph.covariance.labelled import ObjectCovariance
from objgraph.covariance.surface import surface_sigma
from objgraph.datasets.ground_truth import AnnotatedScan, GroundTruth
from objgraph.errors import EvaluationError, InitialisationError, ObservationError, SolveError
from objgraph.estimate import AdamConfig
from objgraph.estimate.task import Estimate, EstimationTask
from objgraph.estimate.terms import RaySteps
from objgraph.graph.builder import ObjectBuilder
from objgraph.graph.initialise import InitialisationConfig
from objgraph.graph.solve import SolverConfig, solve
from objgraph.maps import pipeline as mapping
from objgraph.maps.entry import map_entry, with_trust
from objgraph.maps.object_map import ObjectMap
from objgraph.maps.pipeline import MappingConfig, map_object, map_scan, scene_points
from objgraph.observation.frames import Instance, Scan
from objgraph.observation.sampling import SamplingConfig, observe
from objgraph.priors.registry import prior_for
from objgraph.trust.evidence import evidence_of
from tests.objgraph.trust.calibrations import calibration
from tests.toys import INTRINSICS, ListedFrames, ToyDecoder, toy_frame, toy_mesh, toy_prior, toy_state

UP = np.array([0.0, 0.0, 1.0])
CONFIG = MappingConfig(
    views=2,
    mesh_resolution=40,
    sampling=SamplingConfig(points=150, hits=80, free=80),
    initialisation=InitialisationConfig(headings=4),
    solver=SolverConfig(slopes=(60.0, 200.0), rounds=4),
)
CHAIRS = {1: 0.4, 2: 2.5}
"""Instance id and heading."""


class Secret(Mapping):
    """A ground truth that nobody may look at."""

    def _caught(self, *_):
        raise AssertionError("the estimation has read the ground truth")

    __getitem__ = __iter__ = __len__ = __contains__ = __bool__ = get = items = keys = values = _caught


def chair(instance: int) -> ObjectState:
    state = toy_state(CHAIRS[instance])
    T = state.T_world_object
    aside = np.array([1.3, 0.1, 0.0]) if instance == 2 else np.zeros(3)
    return replace(state, T_world_object=gtsam.Pose3(T.rotation(), T.translation() + aside))


def toy_scan() -> Scan:
    """Two chairs, one object that no pixel shows, one that has no depth, one of a handful of pixels."""
    states = [chair(1), chair(2)]
    frames = [toy_frame(states, azimuth, f"f{i}", seed=i) for i, azimuth in enumerate((0.9, 1.7, 2.4))]
    for frame in frames:
        frame.instances[:8, :8] = 5
    frames[0].instances[100:102, 100:102] = 6
    # tracking was lost: the same pictures once more, before the good ones
    lost = [replace(f, name=f"lost {f.name}", T_world_camera=np.full((4, 4), np.nan)) for f in frames]
    frames = lost + frames
    instances = [Instance(i, "chair") for i in (1, 2, 4, 6)] + [Instance(5, "grand piano")]
    return AnnotatedScan("two chairs", ListedFrames(frames), tuple(instances), UP, Secret())


def toy_priors(category: str, given=()):
    return toy_prior() if category == "chair" else prior_for(category)


def truths() -> dict[int, GroundTruth]:
    found = {}
    for instance in CHAIRS:
        state = chair(instance)
        mesh = toy_mesh(state.code)
        T = state.T_world_object.matrix()
        found[instance] = GroundTruth(T, state.scale, np.asarray(mesh.vertices), np.asarray(mesh.faces))
    return found


@pytest.fixture(scope="module")
def told() -> list:
    return []


@pytest.fixture(scope="module")
def toy_map(told) -> ObjectMap:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(mapping, "prior_for", toy_priors)
        return map_scan(toy_scan(), CONFIG, lambda what, done, total: told.append((what, done, total)))


def entry(object_map: ObjectMap, instance: int) -> Any:
    """A map's entry; what a mapped one must have is tested, not declared."""
    return next(item for item in object_map.objects if item.id == instance)


@pytest.mark.parametrize("instance", CHAIRS)
def test_the_chairs_are_where_they_are(toy_map, instance):
    found, truth = entry(toy_map, instance), chair(instance)
    assert found.status == "mapped"
    assert found.reason is None
    T = gtsam.Pose3(found.T_world_object)
    between = truth.T_world_object.between(T)
    assert np.linalg.norm(gtsam.Rot3.Logmap(between.rotation())) < np.radians(3)
    assert np.linalg.norm(between.translation()) < 0.03
    size = toy_mesh(truth.code).extents * truth.scale
    np.testing.assert_allclose(found.size_m, size, rtol=0.08)


def test_the_failures_say_why_and_the_map_is_whole(toy_map):
    assert [item.id for item in toy_map.objects] == [1, 2, 4, 6, 5]
    assert [item.id for item in toy_map.mapped] == [1, 2]
    reasons = {item.id: item.reason for item in toy_map.objects}
    assert "instance 4" in reasons[4]
    assert "no frame has mask pixels" in reasons[4]
    assert "chair 6: no view can be used: frame f0, object 6: 4 mask pixels" in reasons[6]
    assert "instance 5: no frame has mask pixels of it with depth" in reasons[5]
    for instance in (4, 5, 6):
        assert entry(toy_map, instance).T_world_object is None
        assert entry(toy_map, instance).vertices is None


@pytest.mark.parametrize("instance", CHAIRS)
def test_a_mapped_object_s_fields_agree(toy_map, instance):
    found = entry(toy_map, instance)
    T, scale = found.T_world_object, found.scale
    p_object = (found.vertices - T[:3, 3]) @ T[:3, :3] / scale
    np.testing.assert_allclose(np.ptp(p_object, axis=0) * scale, found.size_m, rtol=1e-6)
    # the vertices are the code's own surface
    np.testing.assert_allclose(np.ptp(p_object, axis=0), toy_mesh(found.code.copy()).extents, atol=0.03)
    assert found.faces.max() < len(found.vertices) == len(found.vertex_sigma)
    assert ((found.vertex_sigma > 0) & (found.vertex_sigma < 0.1)).all()
    assert np.linalg.eigvalsh(found.covariance).min() > 0
    assert found.code_sigma.shape == found.code.shape == (4,)
    # the data have said something: every axis is better known than before
    assert (found.code_sigma < np.sqrt(0.5)).all()
    assert 0 < found.cost_final <= found.cost_initial
    assert found.error_evaluations >= found.linearizations > 0
    assert (found.estimator, found.other) == ("graph", None)
    assert set(found.seconds_by_stage) == {"observe", "initialise", "solve", "mesh"}
    assert found.seconds == pytest.approx(sum(found.seconds_by_stage.values()))
    # frames without a pose take no other's place
    assert len(found.views) == CONFIG.views
    assert set(found.views) <= {"f0", "f1", "f2"}
    cameras = {frame.name: frame.T_world_camera for frame in toy_scan().frames}
    np.testing.assert_allclose(found.cameras, [cameras[name] for name in found.views], atol=1e-12)
    assert (found.prior.name, found.prior.hash) == ("chair", "toy")


def test_progress_is_told(toy_map, told):
    assert told[0] == ("reading frames", 1, 6)
    assert ("mapping chair 2", 1, 5) in told
    assert [each for each in told if each[0].startswith(("mapped chair", "failed"))] == [
        ("mapped chair 1", 1, 5),
        ("mapped chair 2", 2, 5),
        ("failed chair 4", 3, 5),
        ("failed chair 6", 4, 5),
        ("failed grand piano 5", 5, 5),
    ]
    assert told[-1] == ("mapped", 5, 5)


def test_a_map_is_saved_and_read_again(toy_map, tmp_path):
    toy_map.save(tmp_path / "map")
    again = ObjectMap.load(tmp_path / "map")
    assert [item.status for item in again.objects] == [item.status for item in toy_map.objects]
    np.testing.assert_allclose(entry(again, 1).covariance, entry(toy_map, 1).covariance)


def test_evaluation_is_a_step_of_its_own(toy_map):
    measured = evaluate_map(toy_map, truths() | {4: truths()[1]}).objects
    for instance in CHAIRS:
        errors = measured[instance]
        assert errors["pose_correct"]
        assert errors["translation_m"] < 0.03
        assert errors["rotation_deg"] < 3
        assert errors["scale_pct_max"] < 10
        assert errors["chamfer_m"] < 0.03
        found = entry(toy_map, instance).vertices
        true = np.asarray(sample_surface(toy_mesh(chair(instance).code), 3000, seed=0)[0])
        away = KDTree(chair(instance).to_world(true)).query(found)[0]
        assert away.mean() < 0.05
    assert measured[4] == dict.fromkeys(ERROR_KEYS) | {"pose_correct": False}
    assert set(measured) == {*CHAIRS, 4}


def test_the_errors_are_a_file_beside_the_map(toy_map, tmp_path):
    errors = evaluate_map(toy_map, truths() | {4: truths()[1]})
    errors.save(tmp_path)
    document = json.loads((tmp_path / "evaluation.json").read_text())
    assert document["scene"] == "two chairs"
    assert {row.pop("id"): row for row in document["objects"]} == errors.objects
    assert [path.name for path in tmp_path.iterdir()] == ["evaluation.json"]
    (tmp_path / "absent").write_text("a file in the folder's place")
    with pytest.raises(EvaluationError, match=r"absent/evaluation\.json"):
        errors.save(tmp_path / "absent")


def test_the_wrong_truth_is_told_from_the_right_one(toy_map):
    swapped = {1: truths()[2], 2: truths()[1]}
    for instance in CHAIRS:
        errors = evaluate_map(toy_map, swapped).objects[instance]
        assert not errors["pose_correct"]
        assert errors["translation_m"] > 1


def test_what_cannot_be_mapped_raises_its_own_error():
    state = toy_state()
    view = observe(toy_frame([state], 0.3), 1, CONFIG.sampling)
    with pytest.raises(InitialisationError, match="too few"):
        map_object(Instance(3, "chair"), toy_prior(), [], UP, 0.0, CONFIG)

    class Everywhere(ToyDecoder):
        def _network(self, points, injected):
            return super()._network(points, injected) * 0 - 1.0

    filled = replace(toy_prior(), decoder=Everywhere())
    with pytest.raises(InitialisationError, match="no starting shape"):
        map_object(Instance(3, "chair"), filled, [view], UP, 0.0, CONFIG)


def test_an_observation_error_is_a_reason_not_an_end():
    """All views of an object may be unusable for one reason or another; the first is told."""
    scan = toy_scan()
    index = mapping.summarize(scan.frames)
    strict = replace(CONFIG, sampling=SamplingConfig(min_pixels=10**6))
    with pytest.raises(InitialisationError, match="chair 1: no view can be used: frame f"):
        mapping.observe_instance(scan.frames, Instance(1, "chair"), index, strict)
    with pytest.raises(ObservationError, match="instance 77"):
        mapping.observe_instance(scan.frames, Instance(77, "chair"), index, CONFIG)


def test_scene_points_and_floor():
    scan = toy_scan()
    points, colors = scene_points(scan, [3, 4], pixels=500)
    assert points.shape == (1000, 3)
    assert colors is None
    assert -0.05 < points[:, 2].min() < 0.02
    red = np.zeros((2 * INTRINSICS.height, 2 * INTRINSICS.width, 3), np.uint8)
    red[..., 0] = 255
    painted = [replace(frame, color=red) for frame in (scan.frames[3], scan.frames[4])]
    points, colors = scene_points(replace(scan, frames=ListedFrames(painted)), [0, 1], pixels=500)
    np.testing.assert_array_equal(colors, np.tile([1.0, 0, 0], (1000, 1)))
    assert mapping.scene_floor(scan) == pytest.approx(0, abs=0.02)
    blind = replace(scan.frames[3], depth=np.zeros_like(scan.frames[3].depth))
    dark = replace(scan, frames=ListedFrames([blind]))
    assert mapping.scene_floor(dark) is None


def test_the_same_seed_gives_the_same_map():
    state = toy_state(1.0)
    views = [observe(toy_frame([state], a, seed=i), 1, CONFIG.sampling) for i, a in enumerate((0.3, 2.0))]
    one, two = (map_object(Instance(1, "chair"), toy_prior(), views, UP, 0.0, CONFIG) for _ in range(2))
    np.testing.assert_array_equal(one.T_world_object, two.T_world_object)
    np.testing.assert_array_equal(one.code, two.code)
    np.testing.assert_array_equal(one.covariance, two.covariance)


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
    known = calibration(str(prior.card.get("sha256", "unknown")))
    entry = map_entry(Instance(3, "chair"), prior, estimate, task.views, 24)
    assert entry.box_covariance is entry.trust is None
    found = with_trust(entry, task, estimate, known)
    assert found.vertices is not None
    evidence, sides = evidence_of(task, estimate, found.vertices)
    raw = box_pose(prior, state, covariance, state.to_object(found.vertices))
    digest = known.categories["chair"].prior
    expected = known.box("chair", digest, evidence, raw, sides)
    assert expected is not None
    assert found.box_covariance is not None
    assert found.box_centre is not None
    assert found.box_extents is not None
    matrix = expected.covariance.matrix + turns.second_moment(raw.extents)
    np.testing.assert_allclose(found.box_covariance, matrix, rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(found.box_centre, raw.T_world_box.translation(), atol=1e-9)
    np.testing.assert_allclose(found.box_extents, raw.extents)
    assert found.trust == known.trust("chair", digest, evidence)
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
