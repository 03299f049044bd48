"""Priors by category: loaded once a process, shared by all who ask."""

import logging
from dataclasses import replace

import gtsam
import numpy as np
import pytest
import torch

import objgraph
from factors.state import ObjectState
from objgraph.errors import PriorError
from objgraph.priors.categories import ALIASES, LABELS, category_of
from objgraph.priors.fallback import fallback_prior
from objgraph.priors.registry import WEIGHTS, available_priors, load_prior, prior_for
from objgraph.priors.store import save_prior


def test_three_chairs_by_name_share_one_decoder():
    objects = objgraph.ObjectGraph(
        gtsam.NonlinearFactorGraph(), gtsam.Values(), up_world=np.array([0, 0, 1.0])
    )
    upright = gtsam.Pose3(gtsam.Rot3.Rx(np.pi / 2), np.zeros(3))
    state = ObjectState(upright, np.zeros(3), np.zeros(64))
    handles = [objects.add_object(name, state) for name in ("chair", "chair", "Office Chair")]
    assert len({id(handle.prior.decoder) for handle in handles}) == 1


@pytest.mark.parametrize("names", [("table", "desk", "Dining Table"), ("wardrobe", "wardrobe")])
def test_a_category_and_its_aliases_are_one_prior(names):
    assert len({id(prior_for(name)) for name in names}) == 1


def test_stand_ins_keep_the_category_asked_for_share_a_decoder_and_warn_once_each(caplog):
    asked = ["Harp", "harp", "gong", "Harp"]
    with caplog.at_level(logging.WARNING):
        priors = [prior_for(category) for category in asked]
    assert [prior.category for prior in priors] == asked
    assert len({id(prior.decoder) for prior in priors}) == 1
    assert sum("stands in" in record.getMessage() for record in caplog.records) == 2


def test_of_priors_given_the_label_s_own_comes_before_its_category_s_however_it_is_spelt():
    chair, armchair, lamp = (
        replace(fallback_prior(name), card={}) for name in ("chair", "Armchair", "floor_lamp")
    )
    given = [chair, armchair, lamp]
    assert prior_for("armchair", given) is armchair
    assert prior_for("office chair", given) is chair
    assert prior_for("floor lamp", given) is lamp
    assert prior_for("Floor_Lamp", given) is lamp


def test_of_a_prior_given_under_another_label_it_is_said_once_that_it_is_not_used(caplog):
    """ScanNet's couches are loaded as sofas: a prior of couches would be left aside without a word."""
    couch, lamp = (replace(fallback_prior(name), card={}) for name in ("couch", "lamp"))
    assert [prior_for("sofa", [lamp, couch]).category for _ in range(2)] == ["sofa", "sofa"]
    assert prior_for("chair", [lamp, couch]).category == "chair"
    assert prior_for("Couch", [lamp, couch]) is couch
    (record,) = caplog.records
    assert "given for 'couch' serves no object that is called 'sofa'" in record.getMessage()


def test_a_prior_that_was_loaded_by_name_is_one_s_own():
    """It may be trained on, or moved to another device, and nobody else notices."""
    assert load_prior("chair").decoder is not prior_for("chair").decoder
    assert load_prior("chair").decoder is not load_prior("chair").decoder


def test_a_file_that_was_written_anew_is_read_anew(tmp_path):
    path = tmp_path / "lamp.safetensors"
    for size in (0.5, 0.6):
        save_prior(replace(fallback_prior("lamp"), size_mean=size), path)
        assert load_prior(path).size_mean == size


def test_unknown_category_names_those_there_are() -> None:
    with pytest.raises(
        PriorError, match="no shape prior for category 'zebra'; available: bathtub, bed, bookshelf, cabinet, "
    ):
        load_prior("zebra")


def test_shipped_priors() -> None:
    names = (
        "bathtub", "bed", "bookshelf", "cabinet", "car", "chair", "display", "sofa", "table", "trash_bin"
    )  # fmt: skip
    assert available_priors() == names
    for category in available_priors():
        prior = load_prior(category)
        assert prior.category == category
        guess = 0 if prior.guess is None else 4 * sum(value.numel() for value in prior.guess.parameters())
        assert (WEIGHTS / f"{category}.safetensors").stat().st_size - guess < 1_500_000
        assert guess < 4_000_000
        assert np.linalg.eigvalsh(prior.code_covariance).min() > 0
        assert 0 < prior.residual_sigma < 0.02
        assert prior.card["heldout"]["collected"]
        # of the others nothing was measured
        measured = category in ("chair", "table")
        assert (prior.surface_misfit != 1.0) == measured
        with torch.no_grad():
            code = torch.from_numpy(prior.code_mean[None]).float()
            corners = 0.55 * torch.cartesian_prod(*[torch.tensor([-1.0, 1.0])] * 3)
            assert (prior.decoder(corners, code) > 0.05).all()
        attribution = (WEIGHTS / "ATTRIBUTION.txt").read_text()
        owed = prior.card["data"]["collected"]
        assert all(entry["attribution"] in attribution and entry["files"][0] in attribution for entry in owed)


def test_labels_lead_to_one_category_and_to_its_prior() -> None:
    assert set(available_priors()) <= set(LABELS)
    assert len(ALIASES) == sum(len(labels) for labels in LABELS.values())
    assert not set(ALIASES) & set(LABELS)
    for label, category in ALIASES.items():
        assert category_of(f" {label.upper().replace(' ', '_')}") == category
    assert category_of("Piano") == "piano"
    assert load_prior("Office Chair").category == "chair"
