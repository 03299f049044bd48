"""A toy chair, what is seen and known of it, and how arguments made of these are used."""

from dataclasses import replace
from typing import Any

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import X

import objgraph
from factors.base import Annealing
from objgraph.graph.initialise import InitialisationConfig
from objgraph.graph.solve import LevenbergMarquardtConfig
from objgraph.maps import lidar as lidar_mapping
from objgraph.maps import pipeline as mapping
from tests.objgraph.graph.graph_cases import views_of
from tests.toys import toy_frame, toy_prior, toy_state

PRIOR = toy_prior()
STATE = toy_state()
KEYS = objgraph.ObjectKeys.numbered(0)
FRAME = toy_frame([STATE], 0.3)
SAMPLING = objgraph.SamplingConfig(points=40, hits=20, free=20)
VIEWS = [replace(view.thinned(40, 40), frame=view.frame) for view in views_of(STATE)]
COVARIANCE = objgraph.ObjectCovariance.of(1e-4 * np.eye(13), "marginals")
BRIEF = objgraph.SolverConfig(slopes=(60.0,), rounds=1, inner=LevenbergMarquardtConfig(iterations=1))
QUICK = InitialisationConfig(headings=2, guesses=2, shortlist=1, keep=1, points=30, rays=30)
STATE_PARTS: dict[str, Any] = vars(STATE)
FRAME_PARTS: dict[str, Any] = vars(FRAME)
POSE = VIEWS[0].T_world_camera


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


def patched(call: Any) -> None:
    with pytest.MonkeyPatch.context() as patch:
        for module in (mapping, lidar_mapping):
            patch.setattr(module, "prior_for", lambda category, given=(): PRIOR)
        call()
