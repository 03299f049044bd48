"""What is imported from the package, called with arguments that are wrong."""

from dataclasses import replace
from typing import Any

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import X
from hypothesis import given
from hypothesis import strategies as st

import objgraph
from factors.base import Annealing
from factors.code_mixture import CodeMixture, mixture_prior
from factors.decoder import Decoder, DecoderConfig
from factors.depth import DepthFactor, RaySampling
from factors.filled_box import FilledBoxFactor
from factors.floor import FloorFactor, floor_share
from factors.full_distribution import FullDistribution
from factors.gaussian_depth import Deterministic, Probabilistic
from factors.linearized import linearized
from factors.priors import code_prior, placed_prior, scale_prior, sized_prior, upright_prior
from factors.rays import Rays
from factors.superquadric import Superquadric, SuperquadricConfig
from factors.surface import SurfaceFactor
from factors.weighting import Weighting
from objgraph.active.cameras import looking_at, sphere
from objgraph.active.next_view import NextViewConfig
from objgraph.active.target import target
from objgraph.covariance import box_pose, fused, in_world, of_xi, predicted_depth, surface_sigma
from objgraph.covariance.heading_modes import HeadingModes
from objgraph.estimate import AdamConfig
from objgraph.estimate.heading_modes import HeadingModesConfig
from objgraph.graph.initialise import InitialisationConfig
from objgraph.graph.solve import LevenbergMarquardtConfig, minimize
from objgraph.maps import lidar as lidar_mapping
from objgraph.maps import pipeline as mapping
from objgraph.maps.lidar import LidarMappingConfig, map_lidar
from objgraph.maps.lidar_task import DetectorNoise
from objgraph.observation import observe_lidar, road_under, summarize
from objgraph.observation.lidar.frame import Detection, LidarFrame, Picture
from objgraph.observation.lidar.observe import LidarSamplingConfig
from objgraph.observation.lidar.road import RoadConfig
from objgraph.observation.sampling import SensorNoise
from objgraph.observation.view_selection import ViewSelectionConfig
from objgraph.slam.association import AssociationConfig
from objgraph.slam.incremental.config import Tolerance
from objgraph.slam.odometry import OdometryNoise
from tests.fuzz.arguments import arguments, settings_of, wrong
from tests.fuzz.inputs import attempt, fuzzed
from tests.objgraph.graph.graph_cases import UP, views_of
from tests.objgraph.maps.map_cases import mapped, other
from tests.toys import INTRINSICS, ListedFrames, toy_frame, toy_prior, toy_state

PRIOR = toy_prior()
STATE = toy_state()
KEYS = objgraph.ObjectKeys.numbered(0)
FRAME = toy_frame([STATE], 0.3)
SAMPLING = objgraph.SamplingConfig(points=40, hits=20, free=20)
VIEWS = [replace(view.thinned(40, 40), frame=view.frame) for view in views_of(STATE)]
COVARIANCE = objgraph.ObjectCovariance.of(1e-4 * np.eye(13), "marginals")
BRIEF = objgraph.SolverConfig(slopes=(60.0,), rounds=1, inner=LevenbergMarquardtConfig(iterations=1))
QUICK = InitialisationConfig(headings=2, guesses=2, shortlist=1, keep=1, points=30, rays=30)
AFTER = {"frame", "view", "observe"}


def state_of(**changes: Any) -> objgraph.ObjectState:
    return objgraph.ObjectState(**changes)


STATE_PARTS = vars(STATE)
VIEW_PARTS = vars(VIEWS[0])
FRAME_PARTS = vars(FRAME)


def values_at(state: objgraph.ObjectState) -> gtsam.Values:
    values = gtsam.Values()
    state.insert(values, KEYS)
    values.insert(X(0), VIEWS[0].T_world_camera)
    return values


def evaluated(factor: Any, state: objgraph.ObjectState = STATE) -> None:
    """As an optimiser would."""
    graph, values = gtsam.NonlinearFactorGraph(), values_at(state)
    graph.push_back(factor.gtsam_factor() if hasattr(factor, "gtsam_factor") else factor)
    if hasattr(factor, "refresh"):
        factor.refresh(values, Annealing(60.0))
    graph.error(values)
    graph.linearize(values)


# -- what is observed


def use_frame(instance=1, config=SAMPLING, seed=0, **parts: Any) -> None:
    frame = objgraph.Frame(**parts)
    scan = objgraph.Scan("room", ListedFrames([frame]), (objgraph.Instance(1, "chair"),), UP)
    summarize(scan.frames)
    objgraph.maps.scene_floor(scan)
    objgraph.observe(frame, instance, config, seed)


@fuzzed
@given(data=st.data())
def test_frames(data):
    attempt(use_frame, **data.draw(arguments(FRAME_PARTS)))


@fuzzed
@given(data=st.data())
def test_intrinsics(data):
    def use(**parts: Any) -> None:
        use_frame(**(FRAME_PARTS | {"intrinsics": objgraph.Intrinsics(**parts)}))

    attempt(use, **data.draw(arguments(vars(INTRINSICS))))


@fuzzed
@given(data=st.data())
def test_observing(data):
    good = {"frame": FRAME, "instance": 1, "config": SAMPLING, "seed": 0}
    attempt(objgraph.observe, **data.draw(arguments(good)))


@fuzzed
@given(data=st.data())
def test_settings_of_sampling(data):
    kind, noise = data.draw(settings_of(objgraph.SamplingConfig)), data.draw(settings_of(SensorNoise))

    def use() -> None:
        objgraph.observe(FRAME, 1, objgraph.SamplingConfig(**kind))
        objgraph.observe(FRAME, 1, replace(SAMPLING, noise=SensorNoise(**noise)))

    attempt(use)


@fuzzed
@given(data=st.data())
def test_views(data):
    def use(**parts: Any) -> None:
        view = objgraph.ObjectView(**parts)
        for factor in objgraph.ObjectBuilder().view(PRIOR, KEYS, view, view.T_world_camera):
            evaluated(factor)
        objgraph.first_states(PRIOR, [view, *VIEWS], objgraph.ObjectBuilder(up_world=UP), QUICK)

    attempt(use, **data.draw(arguments(VIEW_PARTS)))


@fuzzed
@given(data=st.data())
def test_rays(data):
    def use(**parts: Any) -> None:
        evaluated(DepthFactor(KEYS, PRIOR.decoder, VIEWS[0].T_world_camera, Rays(**parts)))

    attempt(use, **data.draw(arguments(vars(VIEWS[0].rays))))


# -- factors


def test_names_of_the_package_are_there():
    assert all(hasattr(objgraph, name) for name in objgraph.__all__)


POSE = VIEWS[0].T_world_camera
POINTS = {
    "keys": KEYS,
    "decoder": PRIOR.decoder,
    "camera": POSE,
    "points_camera": VIEWS[0].points_camera,
    "sigma": VIEWS[0].points_sigma,
}
FACTORS: dict[Any, tuple[dict[str, Any], dict[str, Any]]] = {
    SurfaceFactor: (
        POINTS,
        {
            "prior_sigma": 0.01,
            "weighting": Weighting(),
            "state_covariance": 1e-4 * np.eye(13),
            "tail": 0.05,
            "body_T_camera": gtsam.Pose3(),
        },
    ),
    DepthFactor: (
        {**dict(list(POINTS.items())[:3]), "rays": VIEWS[0].rays},
        {
            "renderer": FullDistribution(),
            "prior_sigma": 0.01,
            "weighting": Weighting(),
            "sampling": RaySampling(),
            "half_box": np.full(3, 0.5),
            "body_T_camera": gtsam.Pose3(),
        },
    ),
    FloorFactor: (
        {**dict(list(POINTS.items())[:2]), "up_world": UP, "floor": 0.0},
        {
            "sigma": 0.01,
            "spacing": 0.08,
            "stands": 0.4,
            "renderer": FullDistribution(),
            "prior_sigma": 0.01,
            "weighting": Weighting(),
            "half_box": 0.55,
        },
    ),
    FilledBoxFactor: ({**dict(list(POINTS.items())[:2]), "box": np.full(3, 0.6), "sigma": 0.01}, {}),
    code_prior: ({"keys": KEYS, "mean": np.zeros(4), "covariance": np.eye(4)}, {}),
    scale_prior: ({"keys": KEYS, "mean_log_scale": 0.0, "size_sigma": 0.3, "anisotropy_sigma": 0.1}, {}),
    upright_prior: ({"keys": KEYS, "up_world": UP, "sigma": 0.03}, {}),
    placed_prior: (
        {
            "keys": KEYS,
            "T_world_object": gtsam.Pose3(),
            "heading_sigma": 0.1,
            "lean_sigma": 0.1,
            "position_sigma": 0.1,
        },
        {},
    ),
    sized_prior: ({"keys": KEYS, "log_scale": np.zeros(3), "sigma": 0.1}, {}),
}


@pytest.mark.parametrize("make", FACTORS, ids=lambda make: make.__name__)
@fuzzed
@given(data=st.data())
def test_factors(make, data):
    good, optional = FACTORS[make]
    attempt(lambda **given: evaluated(make(**given)), **data.draw(arguments(good, optional)))


@fuzzed
@given(data=st.data())
def test_mixtures_of_codes(data):
    good = {"weight": np.full(2, 0.5), "mean": np.zeros((2, 4)), "variance": np.ones((2, 4))}
    attempt(
        lambda **given: evaluated(mixture_prior(KEYS, CodeMixture(**given))), **data.draw(arguments(good))
    )


@fuzzed
@given(data=st.data())
def test_settings_of_factors(data):
    kind = data.draw(
        st.sampled_from(
            [
                Annealing,
                RaySampling,
                FullDistribution,
                Probabilistic,
                Deterministic,
                Weighting,
                SuperquadricConfig,
            ]
        )
    )
    given = data.draw(settings_of(kind))

    def use() -> None:
        made = kind(**given)
        factor = DepthFactor(
            KEYS, PRIOR.decoder, POSE, VIEWS[0].rays, prior_sigma=0.01,
            renderer=made if hasattr(made, "render") else None,
            sampling=made if kind is RaySampling else None,
            weighting=made if kind is Weighting else None,
        )  # fmt: skip
        factor.refresh(values_at(STATE), made if kind is Annealing else Annealing())
        factor.rows(values_at(STATE))
        if kind is SuperquadricConfig:
            factor = DepthFactor(KEYS, Superquadric(made), POSE, VIEWS[0].rays)
            evaluated(factor, replace(STATE, code=np.zeros(3)))

    attempt(use)


@fuzzed
@given(data=st.data())
def test_decoders(data):
    given = data.draw(settings_of(DecoderConfig)) | {"width": 4, "code_length": 4}
    changed = data.draw(arguments({"width": 4, "code_length": 4, "depth": 2, "skip": 0}))

    def use() -> None:
        for each in (given, changed):
            evaluated(SurfaceFactor(**(POINTS | {"decoder": Decoder(DecoderConfig(**each))})))

    attempt(use)


@fuzzed
@given(data=st.data())
def test_states_and_keys(data):
    state, keys = data.draw(arguments(STATE_PARTS)), data.draw(arguments(vars(KEYS)))
    surface = SurfaceFactor(**POINTS)

    def use() -> None:
        evaluated(surface, objgraph.ObjectState(**state))

    attempt(use)
    attempt(lambda: STATE.insert(gtsam.Values(), objgraph.ObjectKeys(**keys)))
    attempt(lambda: objgraph.ObjectKeys.numbered(keys["pose"]))
    attempt(lambda: floor_share(keys["code"]))
    attempt(lambda: linearized([surface], values_at(objgraph.ObjectState(**state))))


# -- graphs


def own_graph(**given: Any) -> objgraph.ObjectGraph:
    good = {"graph": gtsam.NonlinearFactorGraph(), "values": gtsam.Values(), "initialisation": QUICK}
    return objgraph.ObjectGraph(**(good | {"up_world": UP, "floor": 0.0} | given))


@fuzzed
@given(data=st.data())
def test_object_graphs(data):
    good = {"up_world": UP, "floor": 0.0, "config": objgraph.GraphConfig(), "initialisation": QUICK}
    given = data.draw(arguments(good, {"graph": gtsam.NonlinearFactorGraph(), "values": gtsam.Values()}))

    def use() -> None:
        objects = own_graph(**given)
        handle = objects.add_object(PRIOR, STATE)
        objects.stand_on_floor(handle)

    attempt(use)


@fuzzed
@given(data=st.data())
def test_objects_that_are_added(data):
    good = {
        "prior": PRIOR, "start": STATE, "up_world": UP, "keys": KEYS, "name": "chair", "box": box(),
    }  # fmt: skip
    views = data.draw(st.lists(st.sampled_from(VIEWS), max_size=2))
    given = data.draw(arguments(good | {"start": data.draw(st.sampled_from([STATE, VIEWS, views]))}))

    def use() -> None:
        objects = own_graph()
        try:
            objects.observe(objects.add_object(**given), VIEWS[0])
        except objgraph.ObjectGraphError:
            assert (objects.graph.nrFactors(), objects.values.size(), len(objects.objects)) == (0, 0, 0)
            raise

    attempt(use)


def box(**changes: Any) -> objgraph.DetectedBox:
    good = {
        "T_world_object": STATE.T_world_object, "size": np.ones(3), "position_sigma": 0.1,
        "heading_sigma": 0.1, "size_sigma": 0.1,
    }  # fmt: skip
    return objgraph.DetectedBox(**(good | changes))


@fuzzed
@given(data=st.data())
def test_boxes(data):
    given = data.draw(arguments(vars(box())))
    attempt(lambda: own_graph().add_object(PRIOR, STATE, box=box(**given)))


@fuzzed
@given(data=st.data())
def test_what_is_asked_of_a_graph(data):
    objects = own_graph()
    handle = objects.add_object(PRIOR, STATE)
    gone = objects.add_object(PRIOR, replace(STATE, code=np.ones(4)))
    objects.remove_object(gone)
    objects.observe(handle, VIEWS[0])
    good = {"handle": handle, "view": VIEWS[0], "camera": POSE}
    given = data.draw(arguments(good, {"body_T_camera": POSE}))
    handles = data.draw(st.one_of(st.just(gone), wrong(handle)))
    others = data.draw(st.one_of(wrong([1]), st.lists(st.sampled_from([*KEYS, X(0), -1, 2**70]), max_size=3)))
    size = objects.graph.size()
    if attempt(objects.observe, **given):
        assert objects.graph.size() == size
    attempt(objects.joint_marginals, handle, others)
    for ask in (objects.marginals, objects.state, objects.stand_on_floor, objects.remove_object):
        attempt(ask, handles)
    attempt(objects.refresh, data.draw(wrong(Annealing())))
    attempt(objects.optimize, data.draw(wrong(BRIEF)))


@fuzzed
@given(data=st.data())
def test_settings_of_graphs(data):
    given = data.draw(settings_of(objgraph.GraphConfig))

    def use() -> None:
        builder = objgraph.ObjectBuilder(objgraph.GraphConfig(**given), UP, 0.0)
        single = builder.alone(PRIOR, STATE, VIEWS[:1])
        minimize(single, LevenbergMarquardtConfig(iterations=1))

    attempt(use)


@fuzzed
@given(data=st.data())
def test_settings_of_solving(data):
    solver, inner = (
        data.draw(settings_of(objgraph.SolverConfig)),
        data.draw(settings_of(LevenbergMarquardtConfig)),
    )
    start = data.draw(settings_of(InitialisationConfig))

    def use() -> None:
        thin = [view.thinned(10, 10) for view in VIEWS]
        single = objgraph.ObjectBuilder(up_world=UP).alone(PRIOR, STATE, thin)
        objgraph.solve(
            [single], objgraph.SolverConfig(**({"inner": LevenbergMarquardtConfig(**inner)} | solver))
        )

    def place() -> None:
        config = {**vars(QUICK), **start}
        objgraph.first_states(
            PRIOR, VIEWS, objgraph.ObjectBuilder(up_world=UP), InitialisationConfig(**config)
        )

    attempt(use)
    attempt(place)


# -- incremental


def mapper(**given: Any) -> objgraph.IncrementalObjectGraph:
    config = objgraph.IncrementalConfig(
        sampling=SAMPLING, initialisation=QUICK, start=BRIEF, tracking=BRIEF, rough=BRIEF
    )
    return objgraph.IncrementalObjectGraph(
        **({"up_world": UP, "config": config, "find_prior": lambda _: PRIOR} | given)
    )


def detections() -> list[objgraph.Instance]:
    return [objgraph.Instance(1, "chair")]


@fuzzed
@given(data=st.data())
def test_incremental_maps(data):
    good = {"up_world": UP}
    optional = {"floor": 0.0, "config": None, "find_prior": None, "body_T_camera": POSE, "object_keys": None}
    given = data.draw(arguments(good, optional))

    def use() -> None:
        mapper(**given).update(FRAME, detections())

    attempt(use)


@fuzzed
@given(data=st.data())
def test_updates(data):
    factors = [gtsam.PriorFactorPose3(X(0), POSE, gtsam.noiseModel.Isotropic.Sigma(6, 0.1))]
    good = {"frame": FRAME, "detections": detections(), "camera": X(0)}
    given = data.draw(arguments(good, {"factors": factors, "values": gtsam.Values()}))
    objects = mapper()
    if attempt(objects.update, **given):
        assert not objects.cameras
        objects.update(FRAME, detections())


@fuzzed
@given(data=st.data())
def test_steps_of_a_callers_own_smoother(data):
    isam = gtsam.ISAM2()
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    graph.push_back(gtsam.PriorFactorPose3(X(0), POSE, gtsam.noiseModel.Isotropic.Sigma(6, 0.1)))
    values.insert(X(0), POSE)
    isam.update(graph, values)
    good = {"frame": FRAME, "detections": detections(), "camera": X(0)}
    config = objgraph.IncrementalConfig(
        sampling=SAMPLING, initialisation=QUICK, start=BRIEF, tracking=BRIEF, rough=BRIEF
    )

    def use(**made: Any) -> objgraph.ObjectFrontEnd:
        return objgraph.ObjectFrontEnd(
            **({"smoother": isam, "up_world": UP, "config": config, "find_prior": lambda _: PRIOR} | made)
        )

    attempt(
        use, **data.draw(arguments({"smoother": isam, "up_world": UP}, {"floor": 0.0, "body_T_camera": POSE}))
    )
    front_end = use()
    attempt(front_end.step, **data.draw(arguments(good)))
    attempt(front_end.accept, data.draw(wrong([1])))


@fuzzed
@given(data=st.data())
def test_settings_of_incremental_maps(data):
    kind = data.draw(
        st.sampled_from([objgraph.IncrementalConfig, AssociationConfig, OdometryNoise, Tolerance])
    )
    given = data.draw(settings_of(kind))
    name = {AssociationConfig: "association", OdometryNoise: "odometry", Tolerance: "tolerance"}.get(kind)
    config = {
        "sampling": SAMPLING,
        "initialisation": QUICK,
        "start": BRIEF,
        "tracking": BRIEF,
        "rough": BRIEF,
    }

    def use() -> None:
        changed = given if name is None else {name: kind(**given)}
        objects = mapper(config=objgraph.IncrementalConfig(**(config | changed)))
        objects.update(FRAME, detections())
        objects.update(FRAME, detections())

    attempt(use)


# -- what is known how well


@fuzzed
@given(data=st.data())
def test_covariances(data):
    good = {"matrix": 1e-4 * np.eye(13), "source": "marginals"}
    made, state = data.draw(arguments(good, {"subject": "chair"})), data.draw(arguments(STATE_PARTS))
    corners = np.random.default_rng(0).uniform(-0.5, 0.5, (20, 3))
    directions = data.draw(st.one_of(st.just(np.array([[0.0, 0, 1]])), wrong(np.array([[0.0, 0, 1]]))))
    points = data.draw(st.one_of(st.just(corners), wrong(corners)))
    covariances = data.draw(st.sampled_from([made, good]))
    states = data.draw(st.sampled_from([state, STATE_PARTS]))

    def use(ask: Any) -> None:
        ask(objgraph.ObjectState(**states), objgraph.ObjectCovariance.of(**covariances))

    for ask in (
        lambda s, c: in_world(c, s.T_world_object.rotation()),
        lambda s, c: of_xi(c, s),
        lambda s, c: box_pose(PRIOR, s, c, points),
        lambda s, c: surface_sigma(PRIOR.decoder, s, c, points),
        lambda s, c: predicted_depth(PRIOR.decoder, s, c, POSE, directions).mean,
        lambda s, c: fused((s, c), (STATE, COVARIANCE)),
        lambda s, c: c.ellipsoid(0.5),
    ):
        attempt(use, ask)


@fuzzed
@given(data=st.data())
def test_what_is_asked_of_covariances(data):
    thing = data.draw(wrong(0.5))
    points = np.zeros((1, 3))
    for ask in (
        lambda: in_world(COVARIANCE, thing),
        lambda: of_xi(COVARIANCE, thing),
        lambda: of_xi(thing, STATE),
        lambda: box_pose(PRIOR, STATE, thing, points),
        lambda: box_pose(PRIOR, thing, COVARIANCE),
        lambda: box_pose(PRIOR, STATE, COVARIANCE, np.eye(3), view_cost=thing),
        lambda: box_pose(PRIOR, STATE, COVARIANCE, np.eye(3), turns=HeadingModes(thing)),
        lambda: surface_sigma(thing, STATE, COVARIANCE, points),
        lambda: predicted_depth(PRIOR.decoder, STATE, COVARIANCE, thing, points + 1.0),
        lambda: predicted_depth(PRIOR.decoder, STATE, COVARIANCE, POSE, points + 1.0, samples=thing),
        lambda: predicted_depth(PRIOR.decoder, STATE, COVARIANCE, POSE, points + 1.0, residual_sigma=thing),
        lambda: fused((STATE, COVARIANCE), (STATE, COVARIANCE), thing),
        lambda: fused((STATE, COVARIANCE), thing),
        lambda: COVARIANCE.ellipsoid(thing),
        lambda: COVARIANCE.times(thing),
        lambda: COVARIANCE.block(thing),
        lambda: COVARIANCE.mapped(thing, ("a",)),
        lambda: objgraph.ObjectCovariance.diagonal(thing, "marginals"),
        lambda: objgraph.ObjectCovariance.from_json(thing),
    ):
        attempt(ask)


# -- where to look next


@pytest.fixture(scope="module")
def chair():
    return target("chair 1", PRIOR, STATE, COVARIANCE, points=60, resolution=16)


@fuzzed
@given(data=st.data())
def test_next_views(chair, data):
    good = {"objects": [chair], "cameras": [POSE], "config": NextViewConfig(INTRINSICS)}
    triangle = (np.eye(3), np.array([[0, 1, 2]]))
    optional = {"criterion": "corners", "others": [triangle]}
    attempt(objgraph.next_views, **data.draw(arguments(good, optional)))
    vertices, faces = data.draw(wrong(triangle[0])), data.draw(wrong(triangle[1]))
    attempt(objgraph.next_views, [chair], [POSE], others=[(vertices, triangle[1])])
    attempt(objgraph.next_views, [chair], [POSE], others=[(triangle[0], faces)])


@fuzzed
@given(data=st.data())
def test_settings_of_next_views(chair, data):
    given = data.draw(settings_of(NextViewConfig))
    attempt(lambda: objgraph.next_views([chair], [POSE], NextViewConfig(**given)))


@fuzzed
@given(data=st.data())
def test_targets_and_cameras(data):
    good = {
        "name": "chair",
        "prior": PRIOR,
        "state": STATE,
        "covariance": COVARIANCE,
        "points": 30,
        "resolution": 8,
    }
    attempt(target, **data.draw(arguments(good, {"seen_from": [POSE], "turns": None, "seed": 0})))
    attempt(looking_at, **data.draw(arguments({"eye": np.ones(3), "target": np.zeros(3), "up_world": UP})))
    around = {"centre": np.zeros(3), "radius": 1.0, "up_world": UP, "count": 3}
    attempt(sphere, **data.draw(arguments(around, {"elevations": (0.0, 75.0)})))


# -- maps


@fuzzed
@given(data=st.data())
def test_mapped_objects(data):
    good = mapped(1, other=other())
    given = data.draw(arguments(vars(good)))

    def use() -> None:
        entry = type(good)(**given)
        _ = entry.other_headings, entry.view_cost
        _ = entry.state
        _ = entry.uncertainty

    attempt(use)
    attempt(lambda: type(good.other)(**data.draw(arguments(vars(good.other)))))


@fuzzed
@given(data=st.data())
def test_object_maps(data, tmp_path_factory):
    good = {"scene": "room", "objects": (mapped(1),), "up_world": UP}
    given = data.draw(arguments(good))
    folder = tmp_path_factory.getbasetemp() / "written"
    attempt(lambda: objgraph.ObjectMap(**given).save(folder))
    attempt(objgraph.ObjectMap.load, data.draw(wrong("folder")))
    if folder.exists():
        objgraph.ObjectMap.load(folder)


CHEAP = {
    "views": 2,
    "mesh_resolution": 12,
    "sampling": SAMPLING,
    "initialisation": QUICK,
    "solver": BRIEF,
    "heading_modes": None,
}


@pytest.fixture
def toys(monkeypatch):
    monkeypatch.setattr(mapping, "prior_for", lambda category, given=(): PRIOR)
    monkeypatch.setattr(lidar_mapping, "prior_for", lambda category, given=(): PRIOR)


SCAN = {
    "name": "room",
    "frames": ListedFrames([FRAME]),
    "instances": (objgraph.Instance(1, "chair"),),
    "up_world": UP,
}


def patched(call: Any) -> None:
    with pytest.MonkeyPatch.context() as patch:
        for module in (mapping, lidar_mapping):
            patch.setattr(module, "prior_for", lambda category, given=(): PRIOR)
        call()


@fuzzed
@given(data=st.data())
def test_scans_that_are_mapped(data):
    given = data.draw(arguments(SCAN))
    frames = data.draw(st.lists(wrong(FRAME) | st.just(FRAME), max_size=2).map(ListedFrames))
    instances = data.draw(st.lists(arguments({"id": 1, "category": "chair"}), max_size=2))
    config = mapping.MappingConfig(**CHEAP)
    patched(lambda: attempt(lambda: objgraph.map_scan(objgraph.Scan(**given), config)))
    patched(lambda: attempt(lambda: objgraph.map_scan(objgraph.Scan(**(SCAN | {"frames": frames})), config)))
    patched(
        lambda: attempt(
            lambda: objgraph.map_scan(
                objgraph.Scan(
                    **(SCAN | {"instances": tuple(objgraph.Instance(**each) for each in instances)})
                ),
                config,
            )
        )
    )


@fuzzed
@given(data=st.data())
def test_settings_of_mapping(data):
    kind = data.draw(
        st.sampled_from([objgraph.MappingConfig, ViewSelectionConfig, HeadingModesConfig, AdamConfig])
    )
    given = data.draw(settings_of(kind))
    names = {ViewSelectionConfig: "view", HeadingModesConfig: "heading_modes", AdamConfig: "adam"}
    adam = {"iterations": 2, "points": 20, "rays": 20}

    def use() -> None:
        cheap = CHEAP | ({"estimator": "adam"} if kind is AdamConfig else {})
        changed = (
            given
            if kind not in names
            else {names[kind]: kind(**((adam if kind is AdamConfig else {}) | given))}
        )
        objgraph.map_scan(objgraph.Scan(**SCAN), objgraph.MappingConfig(**(cheap | changed)))

    patched(lambda: attempt(use))


# -- a LiDAR's


def lidar_parts() -> dict[str, Any]:
    view = VIEWS[0]
    T = np.eye(4)
    detection = Detection(1, "chair", STATE.T_world_object.matrix(), np.array([0.7, 1.0, 0.7]))
    return {
        "name": "0",
        "p_lidar": view.points_camera,
        "T_world_lidar": view.T_world_camera.matrix() @ T,
        "up_world": UP,
        "detections": (detection,),
    }


LIDAR = lidar_parts()
DETECTION = LIDAR["detections"][0]
PICTURE = {
    "color": np.zeros((240, 320, 3), np.uint8),
    "intrinsics": INTRINSICS,
    "T_world_camera": FRAME.T_world_camera,
    "instances": FRAME.instances,
}


@fuzzed
@given(data=st.data())
def test_lidar_scans(data):
    given = data.draw(arguments(LIDAR, {"picture": Picture(**PICTURE)}))
    picture = data.draw(arguments(PICTURE))
    detection = data.draw(arguments(vars(DETECTION)))

    def use(**parts: Any) -> None:
        frame = LidarFrame(**(LIDAR | parts))
        road_under(frame.p_world, frame.up_world, DETECTION)
        observe_lidar(frame, frame.detection(1))
        config = LidarMappingConfig(mesh_resolution=12, solver=BRIEF, heading_modes=None)
        map_lidar(frame, config)

    patched(lambda: attempt(use, **given))
    patched(lambda: attempt(lambda: use(picture=Picture(**picture))))
    patched(lambda: attempt(lambda: use(detections=(Detection(**detection),))))


@fuzzed
@given(data=st.data())
def test_settings_of_lidar_scans(data):
    kind = data.draw(st.sampled_from([LidarSamplingConfig, RoadConfig, DetectorNoise, LidarMappingConfig]))
    given = data.draw(settings_of(kind))
    names = {LidarSamplingConfig: "sampling", RoadConfig: "road", DetectorNoise: "detector"}

    def use() -> None:
        cheap: dict[str, Any] = {"mesh_resolution": 12, "solver": BRIEF, "heading_modes": None}
        if kind is LidarMappingConfig:
            cheap |= given
        else:
            cheap["task"] = replace(LidarMappingConfig().task, **{names[kind]: kind(**given)})
        map_lidar(LidarFrame(**LIDAR), LidarMappingConfig(**cheap))

    patched(lambda: attempt(use))
