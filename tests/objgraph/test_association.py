"""Detections and mapped objects: gates that keep their rate, assignments that do not depend on order."""

import logging
from dataclasses import replace

import gtsam
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import binom, chi2

from factors.errors import FactorError
from factors.rays import Rays
from factors.state import ObjectState
from factors.superquadric import SEMI_AXIS, Superquadric
from objgraph.association import AssociationConfig, Detection, MappedCandidate, associate, duplicates
from objgraph.association.gate import Fit, Pair, compare
from objgraph.errors import ObservationError, SolveError
from objgraph.sampling import ObjectView, SamplingConfig, observe
from tests.toys import TOY_CODE, ToyDecoder, look_at, toy_frame, toy_state

EGG, CHAIR = Superquadric(), ToyDecoder()
SAMPLING = SamplingConfig(points=120, hits=60, free=60)
ROUND = -20.0
"""Section and profile of the code of an ellipsoid."""


def egg_view(state: ObjectState, T_world_camera: gtsam.Pose3, rng, count=60, sigma=0.005) -> ObjectView:
    """What a camera sees of a tapered ellipsoid, in closed form; each point errs by itself."""
    u = rng.normal(size=(6 * count, 3))
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    slope = 0.3 * np.tanh(state.code[2])
    width = 1 + slope * u[:, 1]
    p_object = SEMI_AXIS * u * np.stack([width, np.ones_like(width), width], axis=1)
    level = (u[:, 0] ** 2 + u[:, 2] ** 2) * slope
    normal = np.stack([u[:, 0] / width, u[:, 1] - level / width, u[:, 2] / width], axis=1)
    R_world_object = state.T_world_object.rotation().matrix()
    p_world = state.to_world(p_object)
    towards = p_world - T_world_camera.translation()
    seen = np.flatnonzero((towards * (normal / state.scale @ R_world_object.T)).sum(axis=1) < 0)[:count]
    p_camera = towards[seen] @ T_world_camera.rotation().matrix()
    # a quarter of a measurement each: its variance is four times that of the sensor
    p_camera += rng.normal(size=p_camera.shape) * 2 * sigma
    depth = p_camera[:, 2]
    hit = np.ones(len(depth), bool)
    rays = Rays(p_camera / depth[:, None], depth, hit, depth + 1, np.full(len(depth), sigma))
    return ObjectView("egg", T_world_camera, p_camera, np.full(len(depth), sigma), rays, patch=1e-4)


def random_covariance(rng, sigma) -> np.ndarray:
    """Of these standard deviations, strongly correlated."""
    A = rng.normal(size=(len(sigma), len(sigma)))
    S = A @ A.T
    return S * np.outer(sigma, sigma) / np.sqrt(np.outer(np.diag(S), np.diag(S)))


def drawn_pair(rng, with_camera: bool) -> Pair:
    """An egg's estimate (and a camera's), and what a truth drawn from their covariance shows."""
    R = gtsam.Rot3.Rz(rng.uniform(0, 6)).compose(gtsam.Rot3.Rx(np.pi / 2))
    code = np.array([ROUND, ROUND, rng.normal()])
    estimate = ObjectState(gtsam.Pose3(R, rng.normal(size=3)), np.log([0.9, 1.1, 1.0]), code)
    centre, heading = estimate.T_world_object.translation(), rng.uniform(0, 6)
    T_world_camera = gtsam.Pose3(
        look_at(centre + [2.2 * np.cos(heading), 2.2 * np.sin(heading), 1.0], centre)
    )
    sigma = np.repeat([0.03, 0.04, 0.03, 0.2, 0.01, 0.03], 3)[: 18 if with_camera else 12]
    covariance = random_covariance(rng, sigma)
    delta = rng.multivariate_normal(np.zeros(len(sigma)), covariance)
    T_true = T_world_camera.retract(delta[12:]) if with_camera else T_world_camera
    view = egg_view(estimate.retract(delta[:12]), T_true, rng)
    return Pair(
        view, T_world_camera, MappedCandidate("egg", "egg", EGG, estimate, lambda: covariance), covariance
    )


def compare_all(pairs, config) -> list[Fit]:
    return list(compare({(i, i): pair for i, pair in enumerate(pairs)}, config).values())


@pytest.fixture(scope="module")
def drawn():
    rng = np.random.default_rng(1)
    return [drawn_pair(rng, True) for _ in range(300)] + [drawn_pair(rng, False) for _ in range(100)]


@pytest.fixture(scope="module")
def drawn_fits(drawn):
    return compare_all(drawn, AssociationConfig(unmodelled=0.0))


@pytest.mark.parametrize("probability", [0.5, 0.9, 0.99])
def test_truths_drawn_from_the_joint_covariance_pass_at_the_stated_rate(drawn_fits, probability):
    low, high = binom.interval(0.999, len(drawn_fits), probability)
    passed = sum(fit.squared <= chi2.ppf(probability, fit.directions) for fit in drawn_fits)
    assert low <= passed <= high


def test_without_the_cross_blocks_the_rate_is_another(drawn, drawn_fits):
    """The camera's correlation with the object is used, not its variance alone."""
    blind = []
    for pair in drawn[:100]:
        covariance = pair.covariance.copy()
        covariance[:12, 12:] = covariance[12:, :12] = 0
        blind.append(replace(pair, covariance=covariance))
    cut = compare_all(blind, AssociationConfig(unmodelled=0.0))
    ratio = [a.squared / b.squared for a, b in zip(drawn_fits[:100], cut, strict=True)]
    assert np.percentile(ratio, 5) < 0.8
    assert np.percentile(ratio, 95) > 1.25


def test_an_object_a_metre_away_is_refused(drawn):
    away = []
    for pair in drawn[:50]:
        state = pair.candidate.state
        T = state.T_world_object
        elsewhere = gtsam.Pose3(T.rotation(), T.translation() + [1.0, 0.0, 0.0])
        moved = replace(pair.candidate, state=replace(state, T_world_object=elsewhere))
        away.append(replace(pair, candidate=moved))
    config = AssociationConfig()
    assert all(fit.refusal(config) for fit in compare_all(away, config))
    assert sum(fit.refusal(config) is None for fit in compare_all(drawn[:50], config)) >= 48


def test_a_plane_says_where_it_is_along_its_normal_alone():
    state = toy_state()
    rng = np.random.default_rng(0)
    seat = np.stack([rng.uniform(-0.2, 0.2, 50), np.full(50, 0.022), rng.uniform(-0.2, 0.1, 50)], axis=1)
    (view,) = chair_views([state], 0.4)
    p_world = state.to_world(seat) + [0.0, 0.0, 0.03] + rng.normal(size=(50, 3)) * 0.003
    p_camera = (p_world - view.T_world_camera.translation()) @ view.T_world_camera.rotation().matrix()
    flat = replace(view, points_camera=p_camera, points_sigma=np.full(50, 0.005))
    fit = compare_one(Detection(flat, "chair"), mapped(state))
    assert fit.directions == 1
    np.testing.assert_allclose(fit.offset_world, [0.0, 0.0, -0.03], atol=3e-3)


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
    with caplog.at_level(logging.INFO, "objgraph.association"):
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
    turned = detections[0].view.T_world_camera.retract(np.array([0.1, -0.2, 0.1, 0.0, 0.0, 0.0]))
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


@pytest.mark.parametrize("azimuth", [0.6, 2.0, 4.0])
def test_rays_that_pass_through_what_is_mapped_contradict_it(azimuth):
    """A narrow chair, where a map has a wide one: its points lie on that, but rays beside it pass through."""
    narrow, wide = (replace(toy_state(), code=np.array([width, 2.0, 0.3, 0.2])) for width in (-3.0, 4.0))
    (detection,) = seen([narrow], azimuth)
    wrong, right = compare_one(detection, mapped(wide)), compare_one(detection, mapped(narrow))
    assert right.contradicted < 0.05
    assert wrong.contradicted > 0.2
    assert wrong.overlap > 0.5
    strict = AssociationConfig(contradicted=0.2)
    assert right.refusal(strict) is None
    assert "of the rays beside it pass through" in (wrong.refusal(strict) or "")


def compare_one(detection: Detection, entry: MappedCandidate) -> Fit:
    pair = Pair(detection.view, detection.view.T_world_camera, entry, entry.covariance())
    return compare_all([pair], AssociationConfig())[0]


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


@settings(max_examples=8)
@given(st.permutations(range(5)))
def test_duplicates_do_not_depend_on_order(order):
    state = toy_state()
    objects = [
        mapped(shifted(state, 0.03 * i, 0.0, 0.0), f"chair {i}", sigma=0.05 - 0.01 * i) for i in range(3)
    ]
    objects += [mapped(shifted(state, 0.8, 0.0, 0.0)), mapped(state, category="table")]
    merges = duplicates([objects[i] for i in order])
    assert {(order[merge.keep], order[merge.drop]) for merge in merges} == {(2, 0), (2, 1)}


def test_a_chair_started_twice_is_merged_into_the_better_determined(caplog):
    state = toy_state()
    turned = replace(
        shifted(state, 0.06, -0.04, 0.0),
        T_world_object=shifted(state, 0.06, -0.04, 0.0).T_world_object.retract(np.r_[0, 0.1, 0, 0, 0, 0]),
        code=state.code + 0.3,
    )
    objects = [mapped(turned, "late", sigma=0.05), mapped(state, "early", sigma=0.02)]
    with caplog.at_level(logging.INFO, "objgraph"):
        (merge,) = duplicates(objects)
    assert (merge.keep, merge.drop) == (1, 0)
    assert merge.overlap > 0.8
    assert caplog.messages == [merge.reason]
    assert merge.reason.startswith("late is early, which is better determined")


def test_near_but_distinct_chairs_are_not_merged():
    a, b = row(2, 0.58)  # as wide as the chairs are: they touch
    assert duplicates([mapped(a, sigma=0.3), mapped(b, sigma=0.3)]) == ()
    assert duplicates([mapped(a, sigma=0.3), mapped(shifted(a, 0.1, 0.0, 0.0), sigma=0.3)]) != ()


def test_a_joint_covariance_tightens_the_gate_of_duplicates():
    """Both owe their uncertainty to one camera, so that their difference is known well."""
    state = toy_state()
    objects = [mapped(state, sigma=0.2), mapped(shifted(state, 0.12, 0.0, 0.0), sigma=0.2)]
    assert len(duplicates(objects)) == 1
    block = 0.2**2 * np.eye(6)
    config = AssociationConfig(unmodelled=0.005)
    shared = np.block([[block, 0.999 * block], [0.999 * block, block]])
    assert duplicates(objects, config, joint=lambda a, b: shared) == ()
    with pytest.raises(FactorError, match="12x12"):
        duplicates(objects, joint=lambda a, b: np.eye(6))
