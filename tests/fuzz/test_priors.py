"""Shape priors: damaged files, and whole ones (their hash fits) of other headers and tensors."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from factors.code_mixture import CodeMixture
from factors.decoder import Decoder, DecoderConfig
from factors.proportions import Proportions
from objgraph.cli.priors import PriorEntry, describe, priors_table
from objgraph.priors.first_guess import FirstGuess, FirstGuessConfig
from objgraph.priors.shape_prior import ShapePrior
from objgraph.priors.store import load_prior_file, save_prior
from objgraph.priors.tensors import load_tensors
from tests.fuzz.inputs import attempt, fuzzed, replaced
from tests.fuzz.strategies import arrays, changed, damaged
from tests.objgraph.priors.test_store import rewrite

CARD = {
    "data": {"training_shapes": 3, "licences": ["CC0"]},
    "heldout": {"summary": {"count": 2, "chamfer_median": 0.01}},
    "first_guess": {"heldout": {"3": {"heading_right": 0.9}}},
}


@pytest.fixture(scope="module", params=["one Gaussian", "kinds"])
def good(request, tmp_path_factory) -> Path:
    """A small prior with everything that one may have."""
    torch.manual_seed(0)
    decoder = Decoder(DecoderConfig(code_length=3, width=8, depth=3, skip=1, octaves=1))
    guess = FirstGuess(FirstGuessConfig(3, 8, 8, heading_width=8, place_width=8, hidden=8))
    prior = ShapePrior(
        "lamp", decoder, np.arange(3.0), np.diag([1.0, 2.0, 3.0]), 0.01, 0.5, 0.2, CARD, np.zeros((2, 3)),
        0.1, np.array([0.5, 0.6, 0.7]), guess=guess,
    )  # fmt: skip
    if request.param == "kinds":
        rng = np.random.default_rng(0)
        mixture = CodeMixture(np.array([0.25, 0.75]), rng.normal(size=(2, 3)), rng.uniform(0.5, 2.0, (2, 3)))
        known = Proportions(np.zeros(3), rng.normal(size=(3, 3)), np.eye(3))
        prior = replace(prior, kinds=mixture, proportions=known)
    path = tmp_path_factory.mktemp("prior") / "lamp.safetensors"
    save_prior(prior, path)
    use(path)
    return path


def use(path: Path) -> PriorEntry:
    """All that is read of a file, and that it can be used."""
    entry = describe(path)
    priors_table([entry])
    prior = load_prior_file(path)
    assert np.isfinite(prior.draw_codes(3, np.random.default_rng(0))).all()
    assert prior.starts.shape[1:] == prior.code_mean.shape
    assert prior.stands in (True, False)
    assert min(prior.residual_sigma, prior.size_mean, prior.size_log_sigma) > 0
    return entry


def copied(good: Path) -> Path:
    return Path(shutil.copyfile(good, good.parent / "other.safetensors"))


@fuzzed
@given(data=st.data())
def test_a_damaged_file(good, data):
    with replaced(good.parent, good, data.draw(damaged(good))):
        attempt(use, good)


@fuzzed
@given(data=st.data())
def test_a_header_of_other_values(good, data):
    header = data.draw(changed(load_tensors(good)[1]))
    other = copied(good)
    rewrite(other, lambda _, old: (old.clear(), old.update(header if isinstance(header, dict) else {})))
    attempt(use, other)


@fuzzed
@given(data=st.data())
def test_tensors_of_other_shapes_types_and_values(good, data):
    def change(tensors: dict[str, torch.Tensor], _: dict) -> None:
        name = data.draw(st.sampled_from(sorted(tensors)))
        array = data.draw(arrays(tensors.pop(name).numpy().copy()))
        if isinstance(array, np.ndarray) and array.dtype.kind in "fiub":
            tensors[name] = torch.from_numpy(np.array(array, order="C"))

    other = copied(good)
    rewrite(other, change)
    attempt(use, other)
