"""A row of crates, as long as one likes, and a camera that goes along it: maps of any size, of a decoder that costs little."""

from collections.abc import Sequence

import gtsam
import numpy as np
import open3d as o3d
import trimesh

from factors.depth import RaySampling
from objgraph.geometry.frames import look_at
from objgraph.geometry.raycaster import raycaster
from objgraph.graph.builder import GraphConfig
from objgraph.graph.initialise import InitialisationConfig
from objgraph.observation.frames import Frame, FrameSource, Instance, Intrinsics, Scan
from objgraph.observation.sampling import SamplingConfig

UP = np.array([0.0, 0.0, 1.0])
CRATE = "crate"
PERIOD = 10
"""Crates, and metres, after which the row repeats itself."""
SAMPLING = SamplingConfig(points=80, hits=50, free=50)
GRAPH = GraphConfig(sampling=RaySampling(coarse=10, cells=8))
INITIALISATION = InitialisationConfig(headings=4, guesses=4, points=80, rays=80, shortlist=2, keep=1)
_INTRINSICS = Intrinsics(260.0, 260.0, 159.5, 119.5, 320, 240)
_NOISE = 0.003
_ROW = np.random.default_rng(0).uniform([-0.4, 0.45, 0.45, 0.45], [0.4, 0.6, 0.7, 0.6], (PERIOD, 4))
"""Heading, and extents along the object's axes, of each crate of a period."""


def extents(x: int) -> np.ndarray:
    """Of the crate at x along its own axes, metres."""
    return _ROW[x % PERIOD, 1:]


def pose(x: int) -> gtsam.Pose3:
    """T_world_object of the crate at x, its y axis up; the floor is z = 0."""
    R = gtsam.Rot3.Rz(_ROW[x % PERIOD, 0]).compose(gtsam.Rot3.Rx(np.pi / 2))
    return gtsam.Pose3(R, np.array([float(x), 0.0, extents(x)[1] / 2]))


def camera(x: float) -> gtsam.Pose3:
    """T_world_camera of the camera before the place x of the row."""
    return gtsam.Pose3(look_at(np.array([x, -2.2, 1.2]), np.array([x, 0.0, 0.4]), UP))


def picture(x: float, seen: Sequence[int], name: str, seed: int = 0, first: int = 1) -> Frame:
    """What the camera before x sees of some crates, which are numbered from `first` on, and of the floor."""
    meshes = []
    for each in seen:
        box = trimesh.creation.box(extents=extents(each), transform=pose(each).matrix())
        meshes.append((box.vertices, box.faces))
    ground = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) * 20.0 + [x, 0, 0]
    scene, shape = (
        raycaster([*meshes, (ground, np.array([[0, 1, 2], [0, 2, 3]]))]),
        (_INTRINSICS.height, _INTRINSICS.width),
    )
    v, u = np.mgrid[: shape[0], : shape[1]]
    T = camera(x).matrix()
    directions = _INTRINSICS.backproject(u.ravel(), v.ravel()) @ T[:3, :3].T
    rays = np.concatenate([np.broadcast_to(T[:3, 3], directions.shape), directions], axis=1)
    hit = scene.cast_rays(o3d.core.Tensor(rays.astype(np.float32)))
    depth, ids = hit["t_hit"].numpy().astype(float), hit["geometry_ids"].numpy().astype(np.int64)
    noise = np.random.default_rng(seed).normal(size=depth.shape) * _NOISE
    depth = np.where(np.isfinite(depth), depth + noise, 0.0)
    instances = np.where(ids < len(seen), ids + first, 0)
    return Frame(name, depth.reshape(shape), _INTRINSICS, T, instances.reshape(shape))


class _Pictures(FrameSource):
    """A picture of each crate, made when it is asked for."""

    def __init__(self, count: int) -> None:
        self._count = count

    def __len__(self) -> int:
        return self._count

    def __getitem__(self, index: int) -> Frame:
        return picture(float(index), [index], str(index), seed=index, first=index + 1)


def scan(count: int) -> Scan:
    """Of so many crates, each seen once."""
    return Scan(f"{count} crates", _Pictures(count), tuple(Instance(i + 1, CRATE) for i in range(count)), UP)
