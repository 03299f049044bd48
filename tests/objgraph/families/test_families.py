"""The procedural families: canonical frame, closed parts, and the way they face."""

import numpy as np
import pytest
import trimesh
from numpy.testing import assert_allclose
from numpy.typing import NDArray

from objgraph.families import FAMILIES, draw

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
    "bent_shell",
    "zigzag",
    "chunky",
    "block_armchair",
    "slatted",
    "wooden_lounge",
    "parsons",
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


STOOLS = ["legged_stool", "bent_leg_stool", "crossed_stool", "block_stool", "bar_cluster"]


@pytest.mark.parametrize("name", STOOLS)
def test_stool_has_nothing_above_its_seat(name: str) -> None:
    for seed in range(5):
        mesh = FAMILIES["chair"][name](np.random.default_rng(seed))
        top = highest_points(mesh, 0.05)
        # the seat is highest, wide in both directions and centred on the legs
        assert (np.ptp(top[:, [0, 2]], axis=0) > 0.4 * mesh.extents[[0, 2]]).all()
        assert np.abs(top.mean(0)[[0, 2]]).max() < 0.05


@pytest.mark.parametrize("category", ["chair", "table"])
def test_draw_reaches_every_family(category: str) -> None:
    names = {name.split("/")[1].rsplit("_", 2)[0] for name, _ in draw(category, 260, seed=3)}
    assert len(names) > 0.9 * len(FAMILIES[category])
    assert names <= set(FAMILIES[category])


@pytest.mark.parametrize("name", list(FAMILIES["car"]))
def test_car_is_long_symmetrical_and_has_its_cabin_behind_the_bonnet(name: str) -> None:
    roofs = []
    for seed in range(5):
        mesh = FAMILIES["car"][name](np.random.default_rng(seed))
        width, height, length = mesh.extents
        assert length > width
        assert length > height
        wheels = [part for part in mesh.split() if part.bounds[0, 1] < mesh.bounds[0, 1] + 1e-3]
        assert len(wheels) == 4
        assert sum(part.centroid[2] < 0 for part in wheels) == 2
        assert sum(part.centroid[0] < 0 for part in wheels) == 2
        hull, image = mesh.convex_hull, mesh.convex_hull
        image.vertices = image.vertices * [-1, 1, 1]
        assert_allclose(np.sort(hull.vertices[:, 0]), np.sort(image.vertices[:, 0]), atol=0.02)
        body = max(mesh.split(), key=lambda part: part.extents[2])
        points = np.concatenate([part.vertices for part in mesh.split() if part is not body])
        roofs.append(points[points[:, 1] > mesh.bounds[1, 1] - 0.1 * height][:, 2].mean())
    # a bonnet is longer than a boot, and the bed of a pick-up longer than both
    assert np.mean(roofs) < 0 if name == "pickup" else np.mean(roofs) > -0.03


def test_cars_parts_are_few_and_their_shapes_many() -> None:
    cars = [mesh for _, mesh in draw("car", 40, seed=1)]
    assert max(len(mesh.split()) for mesh in cars) <= 25
    extents = np.stack([mesh.extents for mesh in cars])
    assert (extents.std(0) > [0.02, 0.03, 0.02]).all()


@pytest.mark.parametrize("name", [name for name in FAMILIES["table"] if name != "tower"])
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
