"""An object that leaves the view explains nothing of it: whatever the renderer and the estimator, that costs."""

import itertools
from dataclasses import replace

import gtsam
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from factors.base import Annealing
from factors.depth import DepthFactor
from factors.rendering import RaySamples
from factors.state import ObjectKeys
from objgraph.estimate.pool import Pool
from objgraph.estimate.terms import RaySteps, draw_rays
from objgraph.graph.builder import RENDERERS
from objgraph.observation.sampling import ObjectView
from tests.objgraph.estimate.adam_cases import views
from tests.toys import toy_prior, toy_state

KEYS, PRIOR, SLOPE = ObjectKeys.numbered(0), toy_prior(), 400.0
APART = 1.2
"""Metres at which the box is beside where it was."""


def graph_loss(name: str, view: ObjectView, shift: np.ndarray) -> float:
    state, values = shifted(shift), gtsam.Values()
    state.insert(values, KEYS)
    factor = DepthFactor(
        KEYS, PRIOR.decoder, view.T_world_camera, view.rays,
        renderer=RENDERERS[name], prior_sigma=PRIOR.residual_sigma,
    )  # fmt: skip
    factor.refresh(values, Annealing(SLOPE))
    return factor.loss(values)


def descent_loss(name: str, view: ObjectView, shift: np.ndarray) -> float:
    (drawn,) = draw_rays(PRIOR.decoder, [shifted(shift)], [Pool.of([view])], RaySteps(slope=SLOPE))
    sdf = drawn.sdf.double()
    # as the estimator has it: uncertain near the surface alone; nobody descends with the full renderer, whose window
    # would grow by what is uncertain in the box and not out of it
    sigma = torch.full_like(sdf, 0.01) * (drawn.near | (name == "full"))
    samples = RaySamples(sdf, sigma, drawn.cells, drawn.targets, SLOPE)
    return float(RENDERERS[name].score(samples).sum()) / drawn.count


def shifted(shift: np.ndarray):
    state = toy_state()
    T = state.T_world_object
    return replace(state, T_world_object=gtsam.Pose3(T.rotation(), T.translation() + shift))


def in_world(view: ObjectView, direction_camera) -> np.ndarray:
    direction = np.asarray(direction_camera, float)
    return view.T_world_camera.rotation().matrix() @ direction / np.linalg.norm(direction)


LOSSES = {"graph": graph_loss, "descent": descent_loss}


@pytest.mark.parametrize("estimator", LOSSES)
@pytest.mark.parametrize("name", RENDERERS)
def test_leaving_costs_more_than_staying(estimator, name):
    view, loss = views()[0], LOSSES[estimator]
    for direction in ([1, 0, 0], [-1, 0, 0], [0, 1, 0], [1, 0, 1]):
        away = in_world(view, direction)
        at = [loss(name, view, metres * away) for metres in (0.0, 0.3, 1.0, 2.5, 5.0)]
        assert min(at[1:]) > 3 * at[0]
        # only free rays that the object no longer blocks may make it cheaper
        assert at[3] > 0.9 * at[2]
        assert at[4] > 0.9 * at[3]


@settings(max_examples=15)
@given(
    st.sampled_from(sorted(LOSSES)), st.sampled_from(sorted(RENDERERS)),
    st.floats(0, 2 * np.pi), st.floats(0, np.pi / 2), st.lists(st.floats(APART, 5.0), min_size=2, max_size=4),
)  # fmt: skip
def test_beyond_the_overlap_what_should_be_hit_never_costs_less_with_the_distance(
    estimator, name, around, tilt, distances
):
    view = views()[0]
    view = replace(view, rays=view.rays.take(np.flatnonzero(view.rays.hit)))
    direction = [np.cos(around) * np.cos(tilt), np.sin(around) * np.cos(tilt), np.sin(tilt)]
    away = in_world(view, direction)
    found = [LOSSES[estimator](name, view, metres * away) for metres in sorted(distances)]
    # a ray's spread is that at its nearest sample, which differs a little between rays in the box and out of it
    assert all(after >= 0.995 * before for before, after in itertools.pairwise(found))


def test_an_object_behind_what_is_seen_does_not_explain_it():
    """Hits whose background begins before the box does count as well."""
    view = views()[0]
    far = in_world(view, [0, 0, 1])
    ends = replace(view.rays, end=np.minimum(view.rays.end, view.rays.depth + 0.5))
    for name in RENDERERS:
        near, behind = (graph_loss(name, replace(view, rays=ends), m * far) for m in (0.0, 3.0))
        assert behind > 3 * near
