"""Factors and their settings, with arguments that are wrong."""

from dataclasses import replace
from typing import Any

import gtsam
import numpy as np
import pytest
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
from factors.proportions import Proportions, proportions_prior
from factors.superquadric import Superquadric, SuperquadricConfig
from factors.surface import SurfaceFactor
from tests.fuzz.api_cases import (
    KEYS,
    POSE,
    PRIOR,
    STATE,
    STATE_PARTS,
    VIEWS,
    evaluated,
    values_at,
)
from tests.fuzz.arguments import arguments, settings_of
from tests.fuzz.inputs import attempt, fuzzed
from tests.objgraph.graph.graph_cases import UP


def test_names_of_the_package_are_there():
    assert all(hasattr(objgraph, name) for name in objgraph.__all__)


PROPORTIONS = Proportions(np.zeros(3), np.zeros((3, 4)), np.eye(3))
POINTS: dict[str, Any] = {
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
            "share": 0.5,
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
            "share": 0.5,
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
            "share": 0.5,
            "half_box": 0.55,
        },
    ),
    FilledBoxFactor: ({**dict(list(POINTS.items())[:2]), "box": np.full(3, 0.6), "sigma": 0.01}, {}),
    code_prior: ({"keys": KEYS, "mean": np.zeros(4), "covariance": np.eye(4)}, {}),
    scale_prior: ({"keys": KEYS, "mean_log_scale": 0.0, "size_sigma": 0.3, "anisotropy_sigma": 0.1}, {}),
    proportions_prior: (
        {"keys": KEYS, "proportions": PROPORTIONS, "mean_log_size": 0.0, "size_sigma": 0.3},
        {},
    ),
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
def test_proportions_of_codes(data):
    good = {name: getattr(PROPORTIONS, name) for name in ("mean", "slope", "covariance")}
    attempt(
        lambda **given: evaluated(proportions_prior(KEYS, Proportions(**given), 0.0, 0.3)),
        **data.draw(arguments(good)),
    )


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
            parts: dict[str, Any] = POINTS | {"decoder": Decoder(DecoderConfig(**each))}
            evaluated(SurfaceFactor(**parts))

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
