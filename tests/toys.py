"""A toy shape prior in closed form, and pictures of its shapes: the back-end is tested without learnt weights."""

from collections.abc import Callable

import gtsam
import numpy as np
import open3d as o3d
import torch
import trimesh

from factors.decoder import Decoder, DecoderConfig
from factors.state import ObjectState
from objgraph.observation.frames import Frame, Intrinsics
from objgraph.priors.shape_prior import ShapePrior

TOY_CODE = 4
_ROUNDED = 0.01
"""Radius of rounded edges, canonical units."""
INTRINSICS = Intrinsics(260.0, 260.0, 159.5, 119.5, 320, 240)


def toy_boxes(code: torch.Tensor) -> list[tuple[torch.Tensor, torch.Tensor]]:
    """Centre and half size of a chair's block, seat and back, of (b, 4) codes."""
    width, depth, height, thick = 0.26 + 0.05 * code[:, 0], 0.26 + 0.05 * code[:, 1], 0.05 * code[:, 2], 0.04
    thick = thick + 0.01 * code[:, 3]
    zero = torch.zeros_like(width)
    seat = torch.stack([zero, zero - 0.02, zero], 1), torch.stack([width, thick, depth], 1)
    back = (
        torch.stack([zero, 0.2 + height / 2, depth - thick], 1),
        torch.stack([width, 0.2 + height / 2, thick], 1),
    )
    leg = torch.stack([zero, zero - 0.22, zero], 1), torch.stack([0.6 * width, zero + 0.2, 0.6 * depth], 1)
    return [seat, back, leg]


class ToyDecoder(Decoder):
    """Union of three boxes; exact outside, smooth enough for derivatives."""

    def __init__(self) -> None:
        super().__init__(DecoderConfig(code_length=TOY_CODE, width=4, depth=2, skip=0))
        self.requires_grad_(False)

    def _enter(self, codes):
        return {"0": codes}

    def _d_enter(self, codes):
        return {"0": torch.eye(codes.shape[1]).to(codes)[None]}

    def _network(self, points, injected):
        distances = []
        for centre, half in toy_boxes(injected["0"]):
            q = (points - centre).abs() - half
            outside = (q.clamp_min(0).square().sum(dim=1) + 1e-10).sqrt()
            distances.append(outside + q.amax(dim=1).clamp_max(0))
        return torch.stack(distances).amin(dim=0)


class RoundedToyDecoder(ToyDecoder):
    """The toy chair with every edge rounded: as smooth as what is learnt."""

    def _network(self, points, injected):
        distances = []
        for centre, half in toy_boxes(injected["0"]):
            q = ((points - centre).square() + _ROUNDED**2).sqrt() - half
            distances.append(_ROUNDED * torch.logsumexp(q / _ROUNDED, dim=1))
        return -_ROUNDED * torch.logsumexp(-torch.stack(distances) / _ROUNDED, dim=0)


def toy_prior(rounded: bool = False) -> ShapePrior:
    return ShapePrior(
        category="chair",
        decoder=RoundedToyDecoder() if rounded else ToyDecoder(),
        code_mean=np.zeros(TOY_CODE),
        code_covariance=0.5 * np.eye(TOY_CODE),
        residual_sigma=0.008,
        size_mean=1.1,
        size_log_sigma=0.3,
        card={"sha256": "toy"},
    )


def toy_mesh(code: np.ndarray) -> trimesh.Trimesh:
    boxes = toy_boxes(torch.as_tensor(code, dtype=torch.float64)[None])
    mesh = trimesh.util.concatenate(
        [
            trimesh.creation.box(
                extents=2 * half[0].numpy(), transform=trimesh.transformations.translation_matrix(c[0])
            )
            for c, half in boxes
        ]
    )
    assert isinstance(mesh, trimesh.Trimesh)
    return mesh


def toy_state(heading: float = 0.4, code=(0.6, -0.5, 0.3, 0.2)) -> ObjectState:
    """A chair on the floor z = 0 of a world whose z is up."""
    rotation = gtsam.Rot3.Rz(heading).compose(gtsam.Rot3.Rx(np.pi / 2))
    log_scale = np.log([1.0, 1.05, 0.97])
    code = np.array(code, float)
    height = -toy_mesh(code).bounds[0, 1] * np.exp(log_scale[1])
    return ObjectState(gtsam.Pose3(rotation, np.array([0.3, 0.2, height])), log_scale, code)


def look_at(eye, target) -> np.ndarray:
    """T_world_camera of a camera at `eye` that looks at `target`; the world's z is up."""
    forward = np.asarray(target, float) - eye
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0, 0, 1.0])
    right /= np.linalg.norm(right)
    T = np.eye(4)
    T[:3, :3] = np.stack([right, np.cross(forward, right), forward], axis=1)
    T[:3, 3] = eye
    return T


def toy_frame(
    states: list[ObjectState], azimuth: float, name: str = "0", noise: float = 0.003, seed: int = 0
) -> Frame:
    """A noisy picture of toy chairs (ids 1, 2, ...) on a floor, from around their middle."""
    centre = np.mean([state.T_world_object.translation() for state in states], axis=0)
    T = look_at(centre + [2.2 * np.cos(azimuth), 2.2 * np.sin(azimuth), 1.0], centre)
    return toy_picture(states, T, name, noise, seed, floor=4.0)


def toy_picture(
    states: list[ObjectState],
    T: np.ndarray,
    name: str = "0",
    noise: float = 0.003,
    seed: int = 0,
    floor: float = 40.0,
    mesh_of: Callable[[np.ndarray], trimesh.Trimesh] = toy_mesh,
) -> Frame:
    """A noisy picture of chairs (ids 1, 2, ...) from a camera at T_world_camera; `floor`: half its edge, metres."""
    scene = o3d.t.geometry.RaycastingScene()
    for state in states:
        mesh = mesh_of(state.code)
        vertices = state.to_world(np.asarray(mesh.vertices)).astype(np.float32)
        scene.add_triangles(o3d.core.Tensor(vertices), o3d.core.Tensor(np.asarray(mesh.faces, np.uint32)))
    ground = floor * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], np.float32)
    scene.add_triangles(o3d.core.Tensor(ground), o3d.core.Tensor(np.array([[0, 1, 2], [0, 2, 3]], np.uint32)))
    v, u = np.mgrid[: INTRINSICS.height, : INTRINSICS.width]
    directions = INTRINSICS.backproject(u.ravel(), v.ravel()) @ T[:3, :3].T
    rays = np.concatenate([np.broadcast_to(T[:3, 3], directions.shape), directions], axis=1).astype(
        np.float32
    )
    hit = scene.cast_rays(o3d.core.Tensor(rays))
    depth = hit["t_hit"].numpy().astype(float)
    depth[~np.isfinite(depth)] = 0.0
    depth[depth > 0] += np.random.default_rng(seed).normal(size=np.count_nonzero(depth > 0)) * noise
    ids = hit["geometry_ids"].numpy().astype(np.int64)
    instances = np.where(ids < len(states), ids + 1, 0)
    shape = (INTRINSICS.height, INTRINSICS.width)
    return Frame(name, depth.reshape(shape), INTRINSICS, T, instances.reshape(shape))
