"""Meshes of analytic shapes against their closed forms."""

import numpy as np
import pytest
import torch
import trimesh

from factors.decoder import Decoder, DecoderConfig
from factors.sdf_decoder import SdfDecoder
from objgraph.errors import SolveError
from objgraph.priors.mesh import extract_mesh, to_world


class Spheres(SdfDecoder):
    """The union of spheres given as (x, y, z, radius) in the code."""

    def __init__(self, count: int = 1, slope: float = 1.0) -> None:
        super().__init__()
        self.count = count
        self.slope = slope
        self.evaluated = 0

    @property
    def code_length(self):
        return 4 * self.count

    @property
    def like(self):
        return torch.zeros(())

    def _enter(self, codes):
        return {"0": codes}

    def _d_enter(self, codes):
        return {"0": torch.eye(codes.shape[1]).to(codes)[None]}

    def _network(self, points, injected):
        self.evaluated += len(points)
        spheres = injected["0"].reshape(-1, self.count, 4)
        distance = torch.linalg.norm(points[:, None] - spheres[..., :3], dim=-1) - spheres[..., 3]
        return self.slope * distance.min(dim=1).values


def test_a_sphere_has_the_area_and_volume_of_its_closed_form():
    mesh = extract_mesh(Spheres(), np.array([0.05, -0.03, 0.02, 0.4]), resolution=64)
    assert mesh.is_watertight
    assert mesh.volume == pytest.approx(4 / 3 * np.pi * 0.4**3, rel=5e-3)  # positive: oriented outwards
    assert mesh.area == pytest.approx(4 * np.pi * 0.4**2, rel=5e-3)
    np.testing.assert_allclose(mesh.center_mass, [0.05, -0.03, 0.02], atol=1e-3)


def test_every_triangle_faces_outwards():
    mesh = extract_mesh(Spheres(), np.array([0, 0, 0, 0.3]), resolution=32)
    outward = np.einsum("ij,ij->i", mesh.face_normals, mesh.triangles_center)
    assert (outward > 0).all()


@pytest.mark.parametrize("slope", [0.5, 1.0, 3.0])
def test_coarse_to_fine_equals_the_dense_grid_even_where_the_gradient_exceeds_the_bound(slope):
    code = np.array([-0.2, 0, 0, 0.15, 0.2, 0.1, 0, 0.21])
    lazy, dense = Spheres(2, slope), Spheres(2, slope)
    mesh = extract_mesh(lazy, code, resolution=48)
    reference = extract_mesh(dense, code, resolution=48, slope=1e9)
    assert dense.evaluated > 49**3
    assert lazy.evaluated < dense.evaluated / (4 if slope >= 1 else 1.5)
    assert len(mesh.vertices) == len(reference.vertices)
    np.testing.assert_allclose(
        mesh.vertices[np.lexsort(mesh.vertices.round(6).T)],
        reference.vertices[np.lexsort(reference.vertices.round(6).T)],
        atol=1e-5,
    )


def test_floaters_go_and_large_parts_stay():
    code = np.array([0, 0, 0, 0.3, 0.45, 0.45, 0.45, 0.03, -0.42, -0.42, 0, 0.08])
    kept = extract_mesh(Spheres(3), code, resolution=64)
    everything = extract_mesh(Spheres(3), code, resolution=64, remove_floaters=False)
    assert kept.body_count == 2
    assert everything.body_count == 3
    assert kept.bounds[1].max() < 0.35
    assert kept.is_watertight


def test_of_a_shape_in_many_small_parts_the_largest_stays():
    """None of 64 balls has a fiftieth of the surface."""
    grid = np.linspace(-0.4, 0.4, 4)
    balls = [[x, y, z, 0.06] for x in grid for y in grid for z in grid]
    balls[20][3] = 0.065
    kept = extract_mesh(Spheres(64), np.ravel(balls), resolution=64)
    assert kept.body_count == 1
    np.testing.assert_allclose(kept.bounds.mean(axis=0), balls[20][:3], atol=1e-3)


def test_what_leaves_the_grid_is_cut_off_and_closed(caplog):
    mesh = extract_mesh(Spheres(), np.array([0.5, 0, 0, 0.3]), resolution=32)
    assert mesh.is_watertight
    assert mesh.bounds[1, 0] <= 0.55
    assert "cut off" in caplog.text


@pytest.mark.parametrize(("radius", "meaning"), [(-0.1, "outside"), (2.0, "inside")])
def test_without_a_sign_change_the_error_names_the_range_and_what_it_means(radius, meaning):
    with pytest.raises(SolveError, match=rf"lies in .* \.\. .*everything is {meaning}"):
        extract_mesh(Spheres(), np.array([0, 0, 0, radius]), resolution=32)


def test_what_reaches_only_the_grids_border_is_no_surface():
    """Of a ball of radius 0.105 about (0.65, 0, 0) only nodes of the grid's outermost layer are inside."""
    with pytest.raises(SolveError, match=r"no surface: .*everything is outside"):
        extract_mesh(Spheres(), np.array([0.65, 0, 0, 0.105]))


def test_a_diverged_code_is_named():
    with pytest.raises(SolveError, match="not finite"):
        extract_mesh(Spheres(), np.array([0, 0, np.nan, 0.3]), resolution=16)


def test_a_code_of_another_length_is_refused():
    with pytest.raises(SolveError, match=r"\(3,\).*\(4,\)"):
        extract_mesh(Spheres(), np.zeros(3))


def test_a_real_decoder_is_evaluated_without_gradients():
    torch.manual_seed(0)
    decoder = Decoder(DecoderConfig(code_length=4, width=16, depth=3, skip=1))
    with torch.no_grad():
        decoder.output.bias -= decoder(torch.zeros(1, 3), torch.zeros(1, 4))
    mesh = extract_mesh(decoder, np.zeros(4), resolution=16)
    assert mesh.is_watertight
    assert all(parameter.grad is None for parameter in decoder.parameters())


def test_to_world_scales_along_the_objects_axes_before_it_moves():
    box = trimesh.creation.box(extents=[1, 1, 1])
    T = np.array([[0.0, -1, 0, 5], [1, 0, 0, 6], [0, 0, 1, 7], [0, 0, 0, 1]])
    world = to_world(box, T, np.array([1.0, 2.0, 3.0]))
    np.testing.assert_allclose(world.extents, [2, 1, 3])
    np.testing.assert_allclose(world.bounds.mean(axis=0), [5, 6, 7])
    assert world.volume == pytest.approx(6)
    np.testing.assert_allclose(box.extents, 1)


def test_to_world_refuses_a_mirroring_scale():
    with pytest.raises(SolveError, match="positive"):
        to_world(trimesh.creation.box(), np.eye(4), np.array([1.0, -1.0, 1.0]))
