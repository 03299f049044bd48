"""Displays of the benchmark stand on desks."""

from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from objgraph.bench.worlds.cases import BenchmarkConfig, synthetic_cases
from objgraph.bench.worlds.desks import TOP_M, on_desk
from objgraph.geometry.frames import transformed_back
from objgraph.maps.pipeline import scene_floor
from objgraph.synthetic.faults import Difficulty
from objgraph.synthetic.furniture import Furniture
from objgraph.synthetic.parts import join
from objgraph.synthetic.scene import stand
from objgraph.training.meshes.files import canonical


def screen(width: float, height: float, depth: float) -> trimesh.Trimesh:
    """A panel on a foot."""
    panel = trimesh.creation.box(extents=(width, 0.8 * height, 0.2 * depth))
    foot = trimesh.creation.box(extents=(0.4 * width, 0.1 * height, depth))
    panel.apply_translation([0, 0.6 * height, 0])
    foot.apply_translation([0, 0.05 * height, 0])
    return join([panel, foot])


@settings(max_examples=40, deadline=None)
@given(
    st.floats(0.3, 1.5), st.floats(0.25, 0.9), st.floats(0.05, 0.4), st.floats(-3.1, 3.1),
    st.integers(0, 2**32 - 1),
)  # fmt: skip
def test_a_display_stands_on_its_desk_and_looks_where_it_does(width, height, depth, yaw, seed):
    mesh = screen(width, height, depth)
    diagonal = float(np.linalg.norm(mesh.extents))
    piece = Furniture("display", "screen", canonical(mesh, "screen"), diagonal, 1)
    placed = stand(piece, np.full(3, diagonal), np.array([0.3, -0.2]), yaw)
    display, desk = on_desk(placed, np.random.default_rng(seed))
    np.testing.assert_allclose(display.p_world[:, :2], placed.p_world[:, :2], atol=1e-12)
    np.testing.assert_allclose(display.p_world[:, 2].min(), desk.p_world[:, 2].max(), atol=1e-9)
    np.testing.assert_allclose(desk.p_world[:, 2].min(), 0.0, atol=1e-9)
    assert TOP_M[0] <= desk.p_world[:, 2].max() <= TOP_M[1]
    np.testing.assert_allclose(desk.T_world_object[:3, :3], display.T_world_object[:3, :3], atol=1e-9)
    # on the board, its middle behind the board's or at it: the front is at -z
    half = desk.scale * desk.piece.mesh.extents / 2
    p_desk = transformed_back(desk.T_world_object, display.p_world)
    assert (np.abs(p_desk[:, [0, 2]]) <= half[[0, 2]] + 1e-9).all()
    assert (p_desk[:, 2].min() + p_desk[:, 2].max()) / 2 > -1e-9


@pytest.mark.parametrize("difficulty", ["clean", "hard"])
def test_cases_of_displays_are_seen_above_the_floor(tmp_path: Path, difficulty: Difficulty):
    (tmp_path / "display").mkdir()
    screen(1.0, 0.6, 0.2).export(tmp_path / "display" / "screen.ply")
    config = BenchmarkConfig(
        seed=3, objects=2, categories=("display",), meshes=tmp_path, difficulty=difficulty
    )
    for case in synthetic_cases(config):
        scan, world = case.scan(), case.world()
        truth = scan.ground_truth[case.instance.id]
        p_world = truth.scale * truth.vertices @ truth.T_world_object[:3, :3].T + truth.T_world_object[:3, 3]
        assert TOP_M[0] <= p_world[:, 2].min() - world.floor <= TOP_M[1]
        room = world.scene.room
        assert room.clutter[0].piece.family == "desk"
        for i in range(3):
            assert (scan.frames[i].instances == case.instance.id).sum() > 300
        assert world.can_hold(world.first_camera())
        found = scene_floor(scan)
        assert found is None or abs(found - world.floor) < 0.05
