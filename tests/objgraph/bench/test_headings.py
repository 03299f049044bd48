"""The picture of first guesses' reliability."""

import json
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose
from PIL import Image

from objgraph.bench.pictures.headings import HeadingsConfig, headings_picture, reliability
from objgraph.errors import EvaluationError


def test_probabilities_that_hold_lie_on_the_diagonal() -> None:
    rng = np.random.default_rng(0)
    said = rng.random(20_000)
    found = reliability(said, (rng.random(20_000) < said).astype(float), 6)
    assert_allclose(found.right, found.probability, atol=0.03)
    assert (np.diff(found.probability) > 0).all()
    boastful = reliability(said, (rng.random(20_000) < said**2).astype(float), 6)
    assert (boastful.right[1:-1] < boastful.probability[1:-1] - 0.05).all()


def test_the_picture_of_two_categories(tmp_path: Path) -> None:
    rng, files = np.random.default_rng(1), []
    for category in ("chair", "sofa"):
        said = rng.dirichlet(np.ones(4), 60)
        found = {"objects": 60, "probability": said.tolist(), "wanted": np.eye(4)[said.argmax(1)].tolist()}
        files.append(tmp_path / f"{category}.json")
        files[-1].write_text(json.dumps({"category": category, "first_guess": {"3": found}}))
    headings_picture(HeadingsConfig(tmp_path / "plot.png", tuple(files)))
    assert Image.open(tmp_path / "plot.png").size[0] > 300
    with pytest.raises(EvaluationError, match=r"chair\.json has no first guess from 2 views"):
        headings_picture(HeadingsConfig(tmp_path / "plot.png", tuple(files), views=2))
