"""Part swaps: what stays of either solid, that distances are exact, and what is refused."""

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from objgraph.errors import PriorError
from objgraph.families import FAMILIES
from objgraph.families.parts import box, rod
from objgraph.training.meshes.solid import Shell, Solid, SolidDistance, check_sign, solidify
from objgraph.training.meshes.swaps import find_cut, swap

FAMILIES_OF = {"chair": ["dining", "bent_shell", "legged_stool", "chunky"], "table": ["four_leg", "chunky"]}


def chair(seat: float = 0.4, thickness: float = 0.05, width: float = 0.45, leg: float = 0.02) -> Solid:
    """Four square legs whose rear pair runs on to the top as posts, a seat, a back."""
    x, top = width / 2 - leg, seat + 0.4
    parts = [box([width, thickness, width], [0, seat - thickness / 2, 0])]
    parts.append(box([width, 0.15, 0.03], [0, top - 0.1, x]))
    for side in (-x, x):
        parts += [box([2 * leg, seat - 0.01, 2 * leg], [side, (seat - 0.01) / 2, -x])]
        parts += [box([2 * leg, top, 2 * leg], [side, top / 2, x])]
    return Solid("chair", tuple(parts)).warped(lambda points: points)


def column_stool(seat: float = 0.6) -> Solid:
    """A seat on a column and a plate."""
    parts = [box([0.4, 0.06, 0.4], [0, seat - 0.03, 0]), rod([0, 0, 0], [0, seat - 0.01, 0], 0.03)]
    return Solid("stool", (*parts, box([0.3, 0.02, 0.3], [0, 0.01, 0]))).warped(lambda points: points)


def test_cut_is_the_seats_underside() -> None:
    solid = chair(seat=0.4, thickness=0.05)
    scale = solid.closed[0].extents[0] / 0.45
    cut = find_cut(solid, "chair")
    assert_allclose(cut.height - cut.floor, 0.35 * scale, atol=0.004)
    assert_allclose(cut.high - cut.low, 0.45 * scale, atol=0.03)
    assert cut.loose == (0.0, 0.0)


def test_top_and_base_come_from_their_solids() -> None:
    swapped = swap(chair(), column_stool(), "chair", np.random.default_rng(0))
    surface = np.concatenate([mesh.triangles_center for mesh in swapped.surfaces])
    low, high = surface[:, 1].min(), surface[:, 1].max()
    foot = surface[surface[:, 1] < low + 0.3 * (high - low)]
    # one column in the middle instead of legs at the corners, and a back above
    assert np.abs(foot[foot[:, 1] > low + 0.1 * (high - low)][:, [0, 2]]).max(initial=0) < 0.1
    assert surface[surface[:, 1] > high - 0.05][:, 2].min() > 0.05
    everything = np.concatenate([mesh.vertices for mesh in swapped.surfaces])
    assert_allclose(np.linalg.norm(np.ptp(everything, axis=0)), 1)
    assert_allclose(everything.min(0) + everything.max(0), 0, atol=1e-9)


def test_distance_is_that_of_the_boxes() -> None:
    swapped = swap(chair(), chair(seat=0.5, leg=0.03), "chair", np.random.default_rng(1))
    points = np.random.default_rng(2).uniform(-0.6, 0.6, (3000, 3))
    centres = np.stack([mesh.bounds.mean(0) for mesh in swapped.closed])
    halves = np.stack([mesh.extents / 2 for mesh in swapped.closed])
    beyond = np.abs(points[:, None] - centres) - halves
    exact = np.linalg.norm(np.maximum(beyond, 0), axis=2) + np.minimum(beyond.max(2), 0)
    assert_allclose(SolidDistance(swapped)(points), exact.min(1), atol=2e-6)
    assert (exact.min(1) < 0).any()


@pytest.mark.parametrize(("role", "part"), [("top", 0), ("base", 2)])
def test_cut_shell_keeps_its_distance(role: str, part: int) -> None:
    closed = chair()
    body = closed.closed[part]
    # the shell stands off by 4 mm from a seat, or from a front leg that the cut shortens
    grown = trimesh.Trimesh(
        body.vertices + 0.004 * np.sign(body.vertices - body.centroid), body.faces, process=False
    )
    rest = closed.closed[:part] + closed.closed[part + 1 :]
    shelled, other = Solid("open", rest, (Shell(grown, body),)), column_stool()
    pair, known = (
        ((shelled, other), (closed, other)) if role == "top" else ((other, shelled), (other, closed))
    )
    swapped = swap(pair[0], pair[1], "chair", np.random.default_rng(3))
    expected = swap(known[0], known[1], "chair", np.random.default_rng(3))
    assert len(swapped.shells) == 1
    outside = np.random.default_rng(4).uniform(-0.5, 0.5, (5000, 3))
    assert_allclose(SolidDistance(swapped)(outside), SolidDistance(expected)(outside), atol=0.009)


@settings(max_examples=4)
@given(st.sampled_from(["chair", "table"]), st.integers(0, 2**31))
def test_family_members_swap_or_say_why(category: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    names = [str(name) for name in rng.choice(FAMILIES_OF[category], 2)]
    meshes = [FAMILIES[category][name](rng) for name in names]
    top, base = (Solid(n, tuple(m.split(only_watertight=False))) for n, m in zip(names, meshes, strict=True))
    reason = ""
    try:
        swapped = swap(top, base, category, rng)
        check_sign(swapped)
        assert all(mesh.is_watertight for mesh in swapped.closed)
    except PriorError as error:
        reason = str(error)
    assert not reason or any(name in reason for name in names)


def test_part_with_mixed_winding_is_cut_too() -> None:
    solid = chair()
    turned = solid.closed[3].copy()
    turned.faces[0] = turned.faces[0][::-1]
    assert not turned.is_winding_consistent
    swapped = swap(
        Solid("mixed", (*solid.closed[:3], turned, *solid.closed[4:])),
        column_stool(),
        "chair",
        np.random.default_rng(0),
    )
    assert all(mesh.is_watertight for mesh in swapped.closed)


def test_what_cannot_be_swapped_is_named() -> None:
    rng = np.random.default_rng(0)
    bench = chair().warped(lambda points: points * [4, 1, 1])
    with pytest.raises(PriorError, match="would be scaled"):
        swap(bench, chair(), "chair", rng)
    with pytest.raises(PriorError, match="'car'"):
        swap(chair(), chair(), "car", rng)
    pole = solidify(box([0.05, 1.0, 0.05], [0, 0, 0]), "pole").warped(lambda points: points)
    with pytest.raises(PriorError):
        swap(pole, chair(), "chair", rng)
    floating = Solid("lamp", (*chair().closed, box([0.15, 0.15, 0.15], [0.3, 0.3, -0.3])))
    with pytest.raises(PriorError, match="hang in the air"):
        swap(floating, chair(), "chair", rng)
