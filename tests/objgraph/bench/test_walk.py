"""Walks between codes, on a prior whose shapes are boxes."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from objgraph.bench.pictures import walk as walks
from objgraph.bench.pictures.walk import WalkConfig, walk, walk_picture
from objgraph.errors import PriorError
from tests.shapes import MEAN_HALF, box_prior


def test_a_walk_goes_straight_from_one_random_code_to_the_next() -> None:
    config = WalkConfig(Path(), (), codes=3, steps=2, resolution=64, seed=4)
    extents = [mesh.extents for mesh in walk(box_prior(), config)]
    codes = box_prior().draw_codes(3, np.random.default_rng(4))
    np.testing.assert_allclose(extents[::2], 2 * (MEAN_HALF + 0.1 * codes), atol=0.01)
    np.testing.assert_allclose(extents[1::2], (2 * MEAN_HALF + 0.1 * (codes[1:] + codes[:-1])), atol=0.01)


def test_the_picture_has_a_row_a_prior(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(walks, "load_prior", lambda _: box_prior())
    out = tmp_path / "walk.png"
    walk_picture(WalkConfig(out, ("a", "b"), codes=2, steps=2, resolution=32, cell=60))
    picture = np.asarray(Image.open(out).convert("RGB"))
    assert picture.shape[1] == 180
    drawn = np.any(picture < 200, axis=(1, 2))
    assert drawn[: len(drawn) // 2].sum() > 20
    assert drawn[len(drawn) // 2 :].sum() > 20


def test_a_prior_that_there_is_not_is_named(tmp_path: Path) -> None:
    with pytest.raises(PriorError, match="lamp"):
        walk_picture(WalkConfig(tmp_path / "x.png", ("lamp",)))
