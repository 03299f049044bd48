"""One faulty frame, and how wrong it came out."""

from dataclasses import dataclass

import gtsam
import numpy as np
import trimesh
from jaxtyping import Bool, Float
from numpy.random import Generator
from scipy.spatial.distance import cdist

from objgraph.geometry.frames import transformed
from objgraph.geometry.raycaster import seen_from_outside
from objgraph.observation.frames import Frame
from objgraph.synthetic.camera import CameraConfig, Pose, camera_matrix, intrinsics
from objgraph.synthetic.faults import Faults, unit
from objgraph.synthetic.faulty_images import faulty_depth, faulty_masks
from objgraph.synthetic.render import Renderer
from objgraph.synthetic.sensor import SensorConfig

MEASURED = ("mask_precision", "mask_recall", "without_depth", "camera_error_m", "camera_error_deg")
"""Fields of `Photograph` that say how wrong it is."""
_SPOT_M = 0.1
"""Radius of one dark or shiny place."""


@dataclass(frozen=True)
class Photograph:
    """A frame as a person would get it."""

    frame: Frame
    mask_precision: float
    """Share of the target's mask that is the target."""
    mask_recall: float
    """Share of what is seen of the target that its mask has."""
    without_depth: float
    """Share of the mask."""
    camera_error_m: float
    camera_error_deg: float


@dataclass(frozen=True)
class DarkPlaces:
    """Where a surface gives no depth: the same in every view."""

    p_world: Float[np.ndarray, "n 3"]
    """Middles of the spots."""
    radius: Float[np.ndarray, "n"]
    """Of each, metres."""

    def hide(self, p_world: Float[np.ndarray, "m 3"]) -> Bool[np.ndarray, "m"]:
        """Which of some points."""
        return np.any(cdist(p_world, self.p_world) < self.radius, axis=1)


def dark_places(surface: Float[np.ndarray, "f 3 3"], share: float, rng: Generator) -> DarkPlaces:
    """Spots on an object, given by its triangles in the world, that cover a share of what is seen of its surface from outside.

    The last one is as small as that takes.
    """
    edges = surface[:, 1:] - surface[:, :1]
    area = 0.5 * np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1)
    # so many that a spot on a sofa holds twenty: its middle, which is one of them, counts little
    faces = rng.choice(len(surface), 20_000, p=area / area.sum())
    weights = rng.dirichlet([1.0, 1.0, 1.0], 20_000)
    points = (weights[:, None] @ surface[faces])[:, 0]
    solid = trimesh.Trimesh(surface.reshape(-1, 3), np.arange(3 * len(surface)).reshape(-1, 3), process=False)
    left = points[seen_from_outside([solid], points)]
    wanted = round(share * len(left))
    middles: list[np.ndarray] = []
    radii: list[float] = []
    while wanted > 0:
        middles.append(left[rng.integers(len(left))])
        away = np.linalg.norm(left - middles[-1], axis=1)
        radii.append(min(_SPOT_M, float(np.sort(away)[wanted])) if wanted < len(left) else _SPOT_M)
        hidden = away < radii[-1]
        left, wanted = left[~hidden], wanted - int(hidden.sum())
    return DarkPlaces(np.reshape(middles, (-1, 3)), np.array(radii))


def photograph(
    renderer: Renderer,
    T_room_camera: Pose,
    floor: float,
    dark: DarkPlaces,
    target: int,
    faults: Faults,
    sensor: SensorConfig,
    name: str,
    rng: Generator,
) -> Photograph:
    """What a camera at a place of the room makes of it, and where it is said to be; the room's floor is at `floor`."""
    camera = CameraConfig()
    K, width, height = camera_matrix(camera), camera.width, camera.height
    view = renderer.render(K, T_room_camera, width, height)
    T_world_camera = T_room_camera.copy()
    T_world_camera[2, 3] += floor
    v, u = np.nonzero(view.instances == target)
    p_camera = intrinsics().backproject(u, v) * view.depth[v, u, None]
    hidden = np.zeros(view.depth.shape, dtype=bool)
    hidden[v, u] = dark.hide(transformed(T_world_camera, p_camera))
    depth = faulty_depth(view.depth, view.incidence, hidden, faults, sensor, rng)
    masks = faulty_masks(view.instances, target, faults, rng)
    told, error = _told(T_world_camera, faults, rng)
    frame = Frame(name, depth, intrinsics(), told, masks, view.color)
    mask, true = masks == target, view.instances == target
    both = float((mask & true).sum())
    return Photograph(
        frame, both / max(mask.sum(), 1), both / max(true.sum(), 1),
        float((depth[mask] == 0).mean()) if mask.any() else 1.0, *error,
    )  # fmt: skip


def _told(T_world_camera: Pose, faults: Faults, rng: Generator) -> tuple[Pose, tuple[float, float]]:
    """Where the camera is said to be, and by how much that is wrong (metres, degrees)."""
    metres, degrees = faults.camera_m * rng.uniform(0.5, 1.0), faults.camera_deg * rng.uniform(0.5, 1.0)
    step = np.concatenate([np.radians(degrees) * unit(rng), metres * unit(rng)])
    return gtsam.Pose3(T_world_camera).retract(step).matrix(), (float(metres), float(degrees))
