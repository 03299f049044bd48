"""Codes from signed distances and from one view, on a prior whose answers are known."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from factors.code_mixture import CodeMixture
from objgraph.errors import PriorError
from objgraph.training.codes.partial import PartialConfig, fit_view, view_rows
from objgraph.training.codes.search import CodeGaussians, CodeRows, SearchConfig, descend, sample_rows, search
from objgraph.training.codes.single_view import free_points, take_view
from objgraph.training.meshes.samples import SampleConfig, sample_solid
from objgraph.training.meshes.solid import Solid, SolidDistance
from tests.shapes import box_prior, code_of
from tests.toys import toy_mesh

EXTENTS = np.array([0.5, 0.7, 0.5])


def solid_of(mesh: trimesh.Trimesh, name: str = "it") -> Solid:
    mesh = mesh.copy()
    mesh.apply_translation(-mesh.bounds.mean(axis=0))
    mesh.apply_scale(1 / np.linalg.norm(mesh.extents))
    return Solid(name, tuple(mesh.split(only_watertight=False)))


def box(name: str = "box") -> Solid:
    return solid_of(trimesh.creation.box(EXTENTS), name)


def chair(name: str = "chair") -> Solid:
    return solid_of(toy_mesh(np.zeros(4)), name)


def test_the_full_fit_finds_the_box():
    samples = sample_solid(box(), SampleConfig(count=1500), seed=0)
    found = search(box_prior(), sample_rows(samples, effective=1e4))
    np.testing.assert_allclose(found.codes[0], code_of(EXTENTS), atol=0.01)


def test_one_view_of_a_box_about_the_origin_is_enough():
    code = fit_view(box_prior(), take_view(box()), config=PartialConfig(surface_effective=1e4))
    np.testing.assert_allclose(code, code_of(EXTENTS), atol=0.03)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_stretched_rows_are_explained_by_the_box_in_the_decoders_coordinates(axis):
    stretch = np.ones(3)
    stretch[axis] = 1.2
    code = fit_view(box_prior(), take_view(box()), stretch, PartialConfig(surface_effective=1e4))
    half = EXTENTS / np.linalg.norm(EXTENTS) / 2 / stretch
    np.testing.assert_allclose(0.1 * code, half - [0.28, 0.32, 0.26], atol=0.004)


@settings(max_examples=8)
@given(seed=st.integers(0, 1000))
def test_bounds_of_empty_space_hold_for_the_true_shape(seed):
    solid = chair()
    view = take_view(solid, seed)
    points, bound = free_points(view, 1500, 0.05, np.random.default_rng(seed))
    distance = SolidDistance(solid)(points)
    assert (bound >= 0).all()
    assert (bound > 0.045).mean() > 0.2
    # parts thinner than a pixel's distance would be missed between rays; the toy chair has none
    assert (distance >= bound - 2e-3).all()


def test_seen_points_lie_on_the_surface_and_face_the_camera():
    solid = chair()
    view = take_view(solid)
    assert np.abs(SolidDistance(solid)(view.seen)).max() < 1e-5
    before = view.seen + 0.01 * (view.eye - view.seen)
    assert (SolidDistance(solid)(before) > 0).all()
    assert 1.5 <= np.linalg.norm(view.eye) <= 2.0
    assert 0.05 < view.hit.mean() < 0.6


def test_views_are_decided_by_name_and_seed():
    first, again, other = take_view(box("a")), take_view(box("a")), take_view(box("b"))
    np.testing.assert_array_equal(first.eye, again.eye)
    assert np.linalg.norm(first.eye - other.eye) > 0.01
    assert np.linalg.norm(first.eye - take_view(box("a"), seed=1).eye) > 0.01


def test_a_solid_that_the_view_misses_is_an_error():
    away = trimesh.creation.box(
        (0.1, 0.1, 0.1), transform=trimesh.transformations.translation_matrix([9, 9, 9])
    )
    with pytest.raises(PriorError, match="away: nothing of it is seen"):
        take_view(Solid("away", (away,)))


def test_a_bound_counts_only_where_it_is_broken():
    prior = box_prior()
    codes = CodeGaussians.of(prior)
    far = np.array([[0.5, 0.5, 0.5], [0.55, 0, 0]])
    held = CodeRows(far, np.zeros(2), np.full(2, 0.01), np.ones(2), np.ones(2, bool))
    np.testing.assert_allclose(
        descend(prior.decoder, held, codes, np.ones((1, 3)), 20).codes[0], 0, atol=1e-6
    )
    # seen-empty at x = 0.2: the box of half width 0.28 must shrink
    broken = CodeRows(
        np.array([[0.2, 0.0, 0.0]]), np.zeros(1), np.full(1, 0.001), np.full(1, 1e4), np.ones(1, bool)
    )
    code = descend(prior.decoder, broken, codes, np.zeros((1, 3)), 30).codes[0]
    assert 0.28 + 0.1 * code[0] == pytest.approx(0.2, abs=2e-3)
    np.testing.assert_allclose(code[1:], 0, atol=1e-3)


def test_found_codes_are_sorted_by_cost_and_no_start_ends_higher_than_it_began():
    prior = box_prior()
    rows = sample_rows(sample_solid(box(), SampleConfig(count=600), seed=0))
    held = CodeGaussians.of(prior)
    start = descend(prior.decoder, rows, held, prior.starts, 0)
    end = descend(prior.decoder, rows, held, prior.starts, 15)
    assert (np.diff(end.costs) >= 0).all()
    assert end.costs.max() <= start.costs.min() + 1e-9
    assert len(search(prior, rows, SearchConfig(kept=2)).costs) == 2


def test_codes_of_kinds_are_held_to_the_likeliest_as_in_the_graph():
    rng = np.random.default_rng(0)
    kinds = CodeMixture(np.array([0.2, 0.8]), rng.normal(size=(2, 3)), rng.uniform(0.5, 2.0, (2, 3)))
    codes = 2 * rng.normal(size=(6, 3))
    pull = CodeGaussians.of(replace(box_prior(), kinds=kinds)).at(codes)
    np.testing.assert_allclose(pull.cost, 2 * kinds.costs(codes).min(axis=1))
    which = kinds.likeliest(codes)
    np.testing.assert_allclose(pull.gradient, (codes - kinds.mean[which]) / kinds.variance[which])
    np.testing.assert_allclose(np.diagonal(pull.hessian, axis1=1, axis2=2), 1 / kinds.variance[which])


def test_starts_do_not_influence_each_other():
    prior = box_prior()
    rows = sample_rows(sample_solid(box(), SampleConfig(count=600), seed=0))
    held = CodeGaussians.of(prior)
    together = descend(prior.decoder, rows, held, prior.starts, 4)
    alone = [descend(prior.decoder, rows, held, start[None], 4).costs[0] for start in prior.starts]
    np.testing.assert_allclose(together.costs, np.sort(alone), rtol=1e-6)


def test_thinned_rows_count_for_as_much():
    rows = view_rows(take_view(box()), np.ones(3), PartialConfig(), np.random.default_rng(0))
    thin = rows.thinned(100, np.random.default_rng(1))
    assert len(thin) == 100
    assert thin.weight.sum() == pytest.approx(rows.weight.sum())
    assert rows.thinned(10**6, np.random.default_rng(1)) is rows
