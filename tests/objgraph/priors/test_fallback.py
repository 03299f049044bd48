"""Categories without a prior: the superquadric that stands in, and how it is labelled."""

import logging
from dataclasses import replace
from pathlib import Path

import gtsam
import numpy as np
import open3d as o3d
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from factors.superquadric import SEMI_AXIS, Superquadric
from objgraph.graph.initialise import InitialisationConfig, guesses
from objgraph.maps import pipeline as mapping
from objgraph.maps.object_map import ObjectMap
from objgraph.maps.pipeline import MappingConfig, map_scan
from objgraph.observation.frames import Frame, Instance, ListedFrames, Scan
from objgraph.observation.sampling import observe
from objgraph.priors.fallback import fallback_prior
from objgraph.priors.mesh import extract_mesh
from objgraph.priors.registry import available_priors, load_prior, prior_for
from objgraph.priors.shape_prior import ShapePrior
from objgraph.priors.store import save_prior
from objgraph.show.tables import map_table
from tests.toys import INTRINSICS, look_at, toy_prior

UP = np.array([0.0, 0.0, 1.0])
SIZE = np.array([0.5, 0.3, 0.7])
"""Of the bin along its long and its short level side, and upwards, metres."""
HEADING = 0.5
CONFIG = MappingConfig(views=3, mesh_resolution=32)


@pytest.fixture(scope="module")
def bin_frames() -> list[Frame]:
    """A box with id 1 on a floor, from three sides."""
    scene = o3d.t.geometry.RaycastingScene()
    box = o3d.t.geometry.TriangleMesh.create_box(*SIZE).translate([*(-SIZE[:2] / 2), 0.0])
    R = gtsam.Rot3.Rz(HEADING).matrix()
    scene.add_triangles(box.rotate(R, np.zeros(3)).translate([0.2, -0.1, 0.0]))
    floor = np.array([[-4, -4, 0], [4, -4, 0], [4, 4, 0], [-4, 4, 0]], np.float32)
    scene.add_triangles(o3d.core.Tensor(floor), o3d.core.Tensor(np.array([[0, 1, 2], [0, 2, 3]], np.uint32)))
    frames = []
    v, u = np.mgrid[: INTRINSICS.height, : INTRINSICS.width]
    for i, azimuth in enumerate((0.2, 1.6, 3.1)):
        T = look_at([0.2 + 1.8 * np.cos(azimuth), -0.1 + 1.8 * np.sin(azimuth), 1.3], [0.2, -0.1, 0.3])
        directions = INTRINSICS.backproject(u.ravel(), v.ravel()) @ T[:3, :3].T
        rays = np.concatenate([np.broadcast_to(T[:3, 3], directions.shape), directions], axis=1)
        hit = scene.cast_rays(o3d.core.Tensor(rays.astype(np.float32)))
        depth = hit["t_hit"].numpy().astype(float)
        depth[~np.isfinite(depth)] = 0.0
        depth[depth > 0] += np.random.default_rng(i).normal(size=np.count_nonzero(depth)) * 0.003
        shape = (INTRINSICS.height, INTRINSICS.width)
        instances = (hit["geometry_ids"].numpy() == 0).astype(np.int64).reshape(shape)
        frames.append(Frame(f"f{i}", depth.reshape(shape), INTRINSICS, T, instances))
    return frames


@pytest.fixture(scope="module")
def bin_scan(bin_frames) -> Scan:
    return Scan("a bin", ListedFrames(bin_frames), (Instance(1, "laundry basket"),), UP)


@pytest.fixture(scope="module")
def bin_map(bin_scan) -> ObjectMap:
    return map_scan(bin_scan, CONFIG)


def test_an_unknown_object_is_where_it_is_and_as_large(bin_map):
    (found,) = bin_map.objects
    assert found.status == "mapped"
    T = found.T_world_object
    np.testing.assert_allclose(T[:3, 3], [0.2, -0.1, SIZE[2] / 2], atol=0.03)
    # x is along the longer level side, y is up
    np.testing.assert_allclose(found.size_m, SIZE[[0, 2, 1]], rtol=0.12)
    along = np.array([np.cos(HEADING), np.sin(HEADING), 0])
    assert abs(T[:3, 0] @ along) > np.cos(np.radians(6))
    assert T[:3, 1] @ UP > np.cos(np.radians(3))
    assert np.linalg.eigvalsh(found.covariance).min() > 0
    assert found.code_sigma.shape == found.code.shape == (3,)


def test_it_is_labelled_wherever_it_is_told_of(bin_map, tmp_path):
    bin_map.save(tmp_path)
    for object_map in (bin_map, ObjectMap.load(tmp_path)):
        (found,) = object_map.objects
        assert found.prior is not None
        assert (found.category, found.prior.name, found.prior.fallback) == (
            "laundry basket",
            "superquadric",
            True,
        )
        table = map_table(object_map)
        assert "laundry basket*" in list(table.columns[1].cells)
        assert "no prior for this category: stand-in superquadric" in str(table.caption)


def test_one_warning_a_category_names_the_ways_out(bin_scan, caplog):
    twice = replace(bin_scan, instances=tuple(Instance(i, "umbrella stand") for i in (7, 8)))
    with caplog.at_level(logging.WARNING):
        map_scan(twice, CONFIG)
    told = [record.getMessage() for record in caplog.records if "stands in" in record.getMessage()]
    assert len(told) == 1
    for words in ("'umbrella stand'", *available_priors(), "objgraph train", "objgraph convert-prior"):
        assert words in told[0]


def test_known_categories_keep_their_own(caplog):
    assert not prior_for("Office Chair").is_fallback
    assert prior_for("desk").category == "table"
    assert not caplog.records
    assert prior_for("piano").is_fallback


def test_a_prior_of_your_own_comes_first(bin_scan, tmp_path, monkeypatch):
    path = tmp_path / "bin.safetensors"
    save_prior(replace(fallback_prior("Laundry Basket"), card={"data": "mine"}), path)
    (found,) = map_scan(bin_scan, replace(CONFIG, priors=(str(path),), views=1)).objects
    assert found.prior is not None
    assert (found.prior.name, found.prior.fallback) == ("Laundry Basket", False)
    own = replace(toy_prior(), category="chair")
    assert prior_for("armchair", [own]) is own
    assert prior_for("table", [own]) is not own
    with pytest.raises(mapping.ObjectGraphError, match="absent"):
        map_scan(bin_scan, replace(CONFIG, priors=(str(tmp_path / "absent.safetensors"),)))


def test_it_can_be_saved(tmp_path: Path):
    prior = fallback_prior("lamp")
    save_prior(prior, tmp_path / "lamp.safetensors")
    loaded = load_prior(tmp_path / "lamp.safetensors")
    assert isinstance(loaded.decoder, Superquadric)
    assert loaded.is_fallback
    assert loaded.anisotropy_sigma == prior.anisotropy_sigma
    np.testing.assert_array_equal(loaded.starts, prior.starts)


def test_guesses_have_the_box_s_own_sides(bin_frames):
    prior: ShapePrior = fallback_prior("laundry basket")
    views = [observe(frame, 1, CONFIG.sampling, seed=0) for frame in bin_frames]
    states = guesses(prior, views, UP, 0.0, InitialisationConfig())
    sides = states[0].scale * prior.start_extents[0]
    np.testing.assert_allclose(sides, SIZE[[0, 2, 1]], rtol=0.15)
    assert all(state.log_scale[0] > state.log_scale[2] - 0.05 for state in states)


def test_taper_widens_the_top():
    mesh = extract_mesh(Superquadric(), np.array([30.0, 30.0, 30.0]), resolution=64)
    top, bottom = (mesh.vertices[np.abs(mesh.vertices[:, 1] - y * SEMI_AXIS) < 0.05] for y in (0.5, -0.5))
    assert np.ptp(top[:, 0]) > 1.2 * np.ptp(bottom[:, 0])
    assert np.ptp(top[:, 2]) > 1.2 * np.ptp(bottom[:, 2])


@given(code=st.tuples(st.floats(-4, 4), st.floats(-4, 4), st.floats(-2, 2)))
@settings(max_examples=25, deadline=None)
def test_every_code_has_a_surface_of_known_extents_and_nearly_metric_distances(code):
    decoder = Superquadric()
    mesh = extract_mesh(decoder, np.array(code), resolution=32)
    assert mesh.is_watertight
    assert mesh.extents[1] == pytest.approx(2 * SEMI_AXIS, abs=0.02)
    assert (mesh.extents[[0, 2]] > 2 * SEMI_AXIS * 0.95).all()
    assert (mesh.extents[[0, 2]] < 2 * SEMI_AXIS * 1.31).all()
    vertices = torch.as_tensor(np.asarray(mesh.vertices), dtype=torch.float32)
    norm = decoder.linearize(vertices, torch.tensor([code]).float()).d_point.norm(dim=1)
    assert norm.min() > 0.4
    assert norm.max() < 2.0
