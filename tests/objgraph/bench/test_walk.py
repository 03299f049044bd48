"""Walks between codes, on a prior whose shapes are boxes."""

import numpy as np
import pytest
import trimesh
from PIL import Image

from objgraph.bench.pictures import walk as walks
from objgraph.bench.pictures.walk import End, WalkConfig, fitted, unseen_shapes, walk, walk_picture
from objgraph.errors import PriorError
from tests.shapes import MEAN_HALF, box_prior, code_of


def test_a_walk_goes_straight_from_one_box_to_the_other():
    first = End("flat", np.array([0.5, -1.0, 0.5]), np.ones(3))
    last = End("tall", np.array([-0.5, 1.0, -0.5]), np.ones(3))
    meshes = walk(box_prior(), first, last, steps=5, resolution=64)
    for t, mesh in zip(np.linspace(0, 1, 5), meshes, strict=True):
        code = (1 - t) * first.code + t * last.code
        np.testing.assert_allclose(mesh.extents, 2 * (MEAN_HALF + 0.1 * code), atol=0.01)


def test_a_stretch_is_walked_too():
    first, last = (End("", np.zeros(3), np.array([1.0, y, 1.0])) for y in (0.5, 1.5))
    heights = [mesh.extents[1] for mesh in walk(box_prior(), first, last, steps=3, resolution=32)]
    np.testing.assert_allclose(heights, 2 * MEAN_HALF[1] * np.array([0.5, 1.0, 1.5]), atol=0.02)


def test_an_end_is_fitted():
    extents = np.array([0.5, 0.7, 0.5]) / np.linalg.norm([0.5, 0.7, 0.5])
    end = fitted(box_prior(), "box", trimesh.creation.box(extents))
    np.testing.assert_allclose(end.code, code_of(extents), atol=0.06)


@pytest.mark.parametrize("category", ["chair", "table", "car"])
def test_there_are_unseen_shapes_of_every_category(category, tmp_path):
    shapes = unseen_shapes(category, WalkConfig(category, tmp_path / "x.png", pairs=2))
    assert len(shapes) == 3
    for _, mesh in shapes:
        assert np.linalg.norm(mesh.extents) == pytest.approx(1, abs=1e-3)


def test_the_picture_has_a_row_a_pair(tmp_path, monkeypatch):
    monkeypatch.setattr(walks, "load_prior", lambda _: box_prior())
    out = tmp_path / "walk.png"
    walk_picture(WalkConfig("chair", out, pairs=2, steps=3, resolution=32, cell=60))
    picture = np.asarray(Image.open(out).convert("RGB"))
    assert picture.shape[1] == 180
    drawn = np.any(picture < 240, axis=(1, 2))
    assert drawn[: len(drawn) // 2].sum() > 20
    assert drawn[len(drawn) // 2 :].sum() > 20


def test_a_category_without_shapes_is_named(monkeypatch, tmp_path):
    with pytest.raises(PriorError, match="lamp"):
        walk_picture(WalkConfig("lamp", tmp_path / "x.png"))
