"""The procedural families: canonical frame, closed parts, and the way they face."""

import numpy as np
import pytest
import trimesh
from numpy.testing import assert_allclose
from numpy.typing import NDArray

from objgraph.prior.families import FAMILIES, draw

ALL = [(category, name) for category, families in FAMILIES.items() for name in families]
WITH_BACK = [
    "dining",
    "shell",
    "armchair",
    "tub",
    "swivel",
    "executive",
    "pedestal",
    "cantilever",
    "lounge_frame",
]


@pytest.mark.parametrize(("category", "name"), ALL)
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_mesh_is_canonical_and_closed(category: str, name: str, seed: int) -> None:
    mesh = FAMILIES[category][name](np.random.default_rng(seed))
    assert np.isfinite(mesh.vertices).all()
    assert_allclose(mesh.bounds.sum(0), 0, atol=1e-9)
    assert_allclose(np.linalg.norm(mesh.extents), 1)
    for part in mesh.split(only_watertight=False):
        assert part.is_watertight
        assert part.volume > 0


@pytest.mark.parametrize("name", WITH_BACK)
def test_backrest_is_at_positive_z(name: str) -> None:
    for seed in range(5):
        mesh = FAMILIES["chair"][name](np.random.default_rng(seed))
        top = highest_points(mesh, 0.1)
        # what rises highest stands behind the middle, in every family with a back
        assert top[:, 2].mean() > 0.05


@pytest.mark.parametrize("name", list(FAMILIES["table"]))
def test_table_is_a_plate_on_something(name: str) -> None:
    mesh = FAMILIES["table"][name](np.random.default_rng(3))
    points = trimesh.sample.sample_surface(mesh, 20_000, seed=0)[0]
    low, high = mesh.bounds[:, 1]
    assert (points[:, 1] < low + 0.05).any()
    top = points[points[:, 1] > low + 0.6 * (high - low)]
    assert np.ptp(top[:, 0]) > 0.8 * mesh.extents[0]
    assert np.ptp(top[:, 2]) > 0.5 * mesh.extents[2]


def test_same_seed_same_mesh_and_longer_lists_begin_alike() -> None:
    short, long = draw("chair", 3, seed=5), draw("chair", 6, seed=5)
    for (name, mesh), (other_name, other) in zip(short, long, strict=False):
        assert name == other_name
        assert_allclose(mesh.vertices, other.vertices, atol=0)
    assert not _same(draw("chair", 1, seed=6)[0][1], short[0][1])


def test_office_chair_stands_on_a_star() -> None:
    mesh = FAMILIES["chair"]["swivel"](np.random.default_rng(0))
    feet = mesh.vertices[mesh.vertices[:, 1] < mesh.bounds[0, 1] + 0.01]
    angles = np.sort(np.arctan2(feet[:, 2] - feet[:, 2].mean(), feet[:, 0] - feet[:, 0].mean()))
    gaps = np.diff(np.concatenate([angles, [angles[0] + 2 * np.pi]]))
    # five castors leave five wide gaps in the angle about the column
    assert (gaps > np.radians(30)).sum() == 5


def highest_points(mesh: trimesh.Trimesh, share: float) -> NDArray[np.float64]:
    """Surface points in the topmost share of the height."""
    points = trimesh.sample.sample_surface(mesh, 20_000, seed=0)[0]
    low, high = mesh.bounds[:, 1]
    return points[points[:, 1] > high - share * (high - low)]


def _same(first: trimesh.Trimesh, second: trimesh.Trimesh) -> bool:
    return first.vertices.shape == second.vertices.shape and np.allclose(first.vertices, second.vertices)
