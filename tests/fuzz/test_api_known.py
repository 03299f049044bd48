"""Covariances and next views, with arguments that are wrong."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import objgraph
from objgraph.active.cameras import looking_at, sphere
from objgraph.active.next_view import NextViewConfig
from objgraph.active.target import target
from objgraph.covariance import box_pose, fused, in_world, of_xi, predicted_depth, surface_sigma
from objgraph.covariance.heading_modes import HeadingModes
from tests.fuzz.api_cases import (
    COVARIANCE,
    POSE,
    PRIOR,
    STATE,
    STATE_PARTS,
)
from tests.fuzz.arguments import arguments, settings_of, wrong
from tests.fuzz.inputs import attempt, fuzzed
from tests.objgraph.graph.graph_cases import UP
from tests.toys import INTRINSICS


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
