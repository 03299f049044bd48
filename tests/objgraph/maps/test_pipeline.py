"""From a scan to a map: chairs where they are, failures that say why, and no look at the ground truth."""

import json
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import gtsam
import numpy as np
import pytest
from scipy.spatial import KDTree
from trimesh.sample import sample_surface

from factors.state import ObjectState
from objgraph.datasets.ground_truth import AnnotatedScan, GroundTruth
from objgraph.errors import ConfigError, EvaluationError, InitialisationError, ObservationError, ProcessError
from objgraph.graph.initialise import InitialisationConfig
from objgraph.graph.solve import SolverConfig
from objgraph.maps import pipeline as mapping
from objgraph.maps.object_map import ObjectMap
from objgraph.maps.pipeline import MappingConfig, map_object, map_scan, scene_points
from objgraph.metrics.maps import ERROR_KEYS, evaluate_map
from objgraph.observation.frames import Instance, ListedFrames, Scan
from objgraph.observation.sampling import SamplingConfig, observe
from objgraph.priors.registry import prior_for
from tests.toys import INTRINSICS, ToyDecoder, toy_frame, toy_mesh, toy_prior, toy_state

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


def test_the_map_is_the_same_however_many_processes_make_it(toy_map, monkeypatch, caplog):
    monkeypatch.setattr(mapping, "prior_for", toy_priors)
    told = []
    again = map_scan(toy_scan(), CONFIG, lambda *step: told.append(step), jobs=2)
    assert told[-1] == ("mapped", 5, 5)
    assert "chair 6 could not be mapped" in caplog.text
    for ours, theirs in zip(toy_map.objects, again.objects, strict=True):
        assert (ours.id, ours.status, ours.reason) == (theirs.id, theirs.status, theirs.reason)
        for name in ("T_world_object", "code", "joint_covariance", "vertices"):
            np.testing.assert_array_equal(getattr(ours, name), getattr(theirs, name))


def test_an_object_whose_process_dies_says_so_and_stops_no_other(monkeypatch):
    monkeypatch.setattr(mapping, "prior_for", toy_priors)
    monkeypatch.setattr(
        mapping, "spread", lambda works, jobs: ((i, died(i, work)) for i, work in enumerate(works))
    )

    def died(i, work):
        return ProcessError("its process died") if i == 0 else work()

    found = map_scan(toy_scan(), CONFIG)
    assert (found.objects[0].id, found.objects[0].status, found.objects[0].reason) == (
        1,
        "failed",
        "its process died",
    )
    assert [item.id for item in found.mapped] == [2]


@pytest.mark.parametrize("more", [{"jobs": 0}, {"jobs": 1.5}, {"jobs": 2, "watch": print}])
def test_processes_are_some_and_cannot_be_watched(more):
    with pytest.raises(ConfigError, match="jobs"):
        map_scan(toy_scan(), CONFIG, **more)


@pytest.mark.parametrize("more", [{}, {"watch": print}])
def test_an_engine_that_is_none_is_told_before_the_frames_are_read(more):
    def read(*what: object) -> None:
        raise AssertionError("the frames were read")

    with pytest.raises(ConfigError, match="one of local, ray, not 'dask'"):
        map_scan(toy_scan(), CONFIG, read, engine="dask", **more)  # pyright: ignore[reportArgumentType]


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
