"""The project's own street: parked and driving cars before a spinning LiDAR, in the layout of KITTI's benchmark.

Cars are drawn from the procedural families; the sensor has 64 beams, 2 cm of noise and drop-outs; the road leans. The
detections are the labels with a detector's errors. Equal configurations give equal files.
"""

import dataclasses
import hashlib
import json
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import open3d as o3d
import trimesh
from jaxtyping import Float
from matplotlib.colors import hsv_to_rgb

from objgraph.atomic import ensure_folder
from objgraph.families import FAMILIES
from objgraph.geometry.frames import transformed
from objgraph.observation.lidar.kitti_box import KittiBox

_RECORD = "street.json"
_VERSION = 2  # raised when the same configuration begins to give other files
_KINDS = ("sedan", "hatchback", "estate", "suv", "minivan")
_SIZE, _CAMERA_HEIGHT = (1242, 375), 1.65
_K = np.array([[721.5, 0.0, 609.6], [0.0, 721.5, 172.9], [0.0, 0.0, 1.0]])
_CAMERA_RIGHT = 0.06
"""Of the colour camera against camera 0, whose frame is the labels', metres."""
_LIDAR = np.array([0.0, -0.08, -0.27])
"""Place of the LiDAR in that frame."""
_VELODYNE_AXES = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
"""Its axes (x ahead, y left, z up) as columns in that frame."""
_LANES = (-6.0, -3.2, 0.0, 3.6)
"""Metres to the right: parked, oncoming, ahead, parked."""


@dataclass(frozen=True)
class StreetConfig:
    """A street, and what is seen of it."""

    seed: int = 5
    frames: int = 2
    cars: int = 5
    """In every frame."""
    noise: float = 0.02
    """Standard deviation of a range, metres."""
    dropped: float = 0.05
    """Share of beams that do not come back."""
    lean: float = 0.02
    """Standard deviation of the road's slope along and across, radians."""
    position_sigma: float = 0.25
    """Of the detections' middles along each axis, metres."""
    heading_sigma_deg: float = 6.0
    size_sigma: float = 0.06
    """Of the detections' edges, relative."""
    least_returns: int = 50
    """Cars with fewer are not detected."""


@dataclass(frozen=True)
class _Car:
    box: KittiBox
    p_rect: Float[np.ndarray, "v 3"]
    faces: np.ndarray


_DEFAULT = StreetConfig()


def ensure_street(cache: Path, config: StreetConfig = _DEFAULT) -> Path:
    """The root of the street under `cache`, generated when it is not there yet."""
    record = json.dumps([_VERSION, dataclasses.asdict(config)], sort_keys=True)
    root = cache / f"street-{hashlib.sha256(record.encode()).hexdigest()[:12]}"
    return ensure_folder(root, _RECORD, lambda folder: _write(folder, config))


def _write(root: Path, config: StreetConfig) -> None:
    training = root / "training"
    for folder in ("velodyne", "calib", "image_2", "label_2"):
        (training / folder).mkdir(parents=True)
    (root / "detections").mkdir()
    for index, rng in enumerate(np.random.default_rng(config.seed).spawn(config.frames)):
        name = f"{index:06d}"
        road = _road(rng, config)
        cars = _cars(road, config.cars, rng)
        scene = _scene(cars, road)
        returns = _scan(scene, config, rng)
        velodyne = np.column_stack([(returns - _LIDAR) @ _VELODYNE_AXES, np.full(len(returns), 0.3)])
        (training / "velodyne" / f"{name}.bin").write_bytes(velodyne.astype("<f4").tobytes())
        (training / "calib" / f"{name}.txt").write_text(_calibration())
        _, png = cv2.imencode(".png", _image(scene, len(cars), rng)[..., ::-1])
        (training / "image_2" / f"{name}.png").write_bytes(png.tobytes())
        labels = [car.box for car in cars]
        (training / "label_2" / f"{name}.txt").write_text("".join(map(_line, labels)))
        seen = [box for box in labels if np.count_nonzero(box.box.contains(returns)) >= config.least_returns]
        detected = [_detected(box, config, rng) for box in seen]
        (root / "detections" / f"{name}.txt").write_text("".join(map(_line, detected)))
    record = {"version": _VERSION, "config": dataclasses.asdict(config)}
    (root / _RECORD).write_text(json.dumps(record, indent=1) + "\n")


def _road(rng: np.random.Generator, config: StreetConfig) -> Float[np.ndarray, "3"]:
    """y (down) of the road as (offset, slope to the right, slope ahead)."""
    return np.array([_CAMERA_HEIGHT, *rng.normal(0.0, config.lean, size=2)])


def _cars(road: Float[np.ndarray, "3"], count: int, rng: np.random.Generator) -> list[_Car]:
    cars: list[_Car] = []
    while len(cars) < count:
        lane = int(rng.integers(len(_LANES)))
        x, z = _LANES[lane] + rng.normal(0, 0.15), rng.uniform(6.0, 32.0)
        if any(abs(car.box.bottom[0] - x) < 2.3 and abs(car.box.bottom[2] - z) < 6.0 for car in cars):
            continue
        height, width, length = rng.normal([1.53, 1.63, 3.9], [0.08, 0.08, 0.3])
        yaw = (np.pi / 2 if lane == 1 else -np.pi / 2) + rng.normal(0, 0.05)
        bottom = np.array([x, road @ [1.0, x, z], z])
        box = KittiBox("Car", 0.0, 0, np.zeros(4), height, width, length, bottom, yaw, None)
        mesh = FAMILIES["car"][str(rng.choice(_KINDS))](rng)
        p_object = (mesh.vertices - mesh.bounds.mean(axis=0)) / mesh.extents * box.size
        T = box.T_rect_object
        p_rect = transformed(T, p_object)
        cars.append(_Car(dataclasses.replace(box, image_box=_image_box(p_rect)), p_rect, mesh.faces))
    return cars


def _scene(cars: list[_Car], road: Float[np.ndarray, "3"]) -> o3d.t.geometry.RaycastingScene:
    """The cars, then the road, then house fronts on both sides."""
    scene = o3d.t.geometry.RaycastingScene(nthreads=1)
    corners = np.array([[x, 0.0, z] for z in (-5.0, 90.0) for x in (-14.0, 14.0)])
    corners[:, 1] = np.column_stack([np.ones(4), corners[:, [0, 2]]]) @ road
    quads = np.array([[0, 1, 2], [1, 3, 2]])
    fronts = [trimesh.creation.box((0.2, 12.0, 95.0)) for _ in range(2)]
    for front, x in zip(fronts, (-11.0, 9.0), strict=True):
        front.apply_translation([x, -3.0, 42.0])
    meshes = [(car.p_rect, car.faces) for car in cars] + [(corners, quads)]
    for vertices, faces in [*meshes, *((front.vertices, front.faces) for front in fronts)]:
        scene.add_triangles(_tensor(vertices), o3d.core.Tensor(np.ascontiguousarray(faces, np.uint32)))
    return scene


def _scan(
    scene: o3d.t.geometry.RaycastingScene, config: StreetConfig, rng: np.random.Generator
) -> Float[np.ndarray, "n 3"]:
    """Returns of one turn of 64 beams, as far as they are ahead."""
    elevation = np.radians(np.linspace(-24.8, 2.0, 64))
    azimuth = np.radians(np.arange(-42.0, 42.0, 0.1728))
    elevation, azimuth = (angle.ravel() for angle in np.meshgrid(elevation, azimuth))
    level = np.cos(elevation)
    directions = np.column_stack([level * np.sin(azimuth), -np.sin(elevation), level * np.cos(azimuth)])
    distance = _cast(scene, _LIDAR, directions)["t_hit"].numpy().astype(float)
    back = (distance < 80.0) & (rng.random(len(distance)) > config.dropped)
    noisy = distance[back] + rng.normal(0.0, config.noise, np.count_nonzero(back))
    return _LIDAR + noisy[:, None] * directions[back]


def _image(scene: o3d.t.geometry.RaycastingScene, cars: int, rng: np.random.Generator) -> np.ndarray:
    width, height = _SIZE
    u, v = np.meshgrid(np.arange(width), np.arange(height))
    directions = np.stack([u, v, np.ones_like(u)], axis=-1).reshape(-1, 3) @ np.linalg.inv(_K).T
    cast = _cast(scene, np.array([_CAMERA_RIGHT, 0.0, 0.0]), directions)
    geometry = cast["geometry_ids"].numpy().astype(np.int64)
    hit = np.isfinite(cast["t_hit"].numpy())
    coats = hsv_to_rgb(np.column_stack([rng.random(cars), *rng.uniform(0.2, 0.9, (2, cars))]))
    tones = np.concatenate([coats, [[0.35, 0.35, 0.37], [0.6, 0.5, 0.45], [0.65, 0.6, 0.5]]])
    normals = cast["primitive_normals"].numpy().astype(float)
    light = 0.45 + 0.55 * np.abs(normals @ [0.35, -0.8, -0.48])
    color = np.where(hit[:, None], tones[np.where(hit, geometry, 0)] * light[:, None], [0.65, 0.78, 0.92])
    return (255 * np.clip(color, 0, 1)).astype(np.uint8).reshape(height, width, 3)


def _cast(
    scene: o3d.t.geometry.RaycastingScene, origin: np.ndarray, directions: Float[np.ndarray, "n 3"]
) -> dict[str, o3d.core.Tensor]:
    return scene.cast_rays(_tensor(np.column_stack([np.tile(origin, (len(directions), 1)), directions])))


def _detected(box: KittiBox, config: StreetConfig, rng: np.random.Generator) -> KittiBox:
    """A label with a detector's errors, also in the picture."""
    grown = 1.0 + rng.normal(0.0, config.size_sigma, size=3)
    height, width, length = grown * [box.height, box.width, box.length]
    found = dataclasses.replace(
        box,
        truncation=-1.0,
        occlusion=-1,
        height=height,
        width=width,
        length=length,
        bottom=box.bottom + rng.normal(0.0, config.position_sigma, size=3),
        yaw=box.yaw + np.radians(rng.normal(0.0, config.heading_sigma_deg)),
        score=float(rng.uniform(0.5, 0.95)),
    )
    corners = found.size * (np.array(list(np.ndindex(2, 2, 2))) - 0.5)
    return dataclasses.replace(found, image_box=_image_box(transformed(found.T_rect_object, corners)))


def _image_box(p_rect: Float[np.ndarray, "v 3"]) -> Float[np.ndarray, "4"]:
    """Left, top, right and bottom of what projects into the picture."""
    p_camera = p_rect - [_CAMERA_RIGHT, 0.0, 0.0]
    pixels = p_camera[p_camera[:, 2] > 0.5] @ _K.T
    pixels = pixels[:, :2] / pixels[:, 2:]
    edge = np.array(_SIZE) - 1.0
    return np.concatenate([pixels.min(axis=0).clip(0, edge), pixels.max(axis=0).clip(0, edge)])


def _line(box: KittiBox) -> str:
    alpha = (box.yaw - np.arctan2(box.bottom[0], box.bottom[2]) + np.pi) % (2 * np.pi) - np.pi
    numbers = [
        box.truncation, box.occlusion, alpha, *box.image_box, box.height, box.width, box.length, *box.bottom, box.yaw,
        *([] if box.score is None else [box.score]),
    ]  # fmt: skip
    return f"{box.type} {numbers[0]:g} {box.occlusion} " + " ".join(f"{x:.4f}" for x in numbers[2:]) + "\n"


def _calibration() -> str:
    P2 = np.column_stack([_K, -_K @ [_CAMERA_RIGHT, 0.0, 0.0]])
    Tr = np.column_stack([_VELODYNE_AXES, _LIDAR])
    matrices = {"P2": P2, "R0_rect": np.eye(3), "Tr_velo_to_cam": Tr}
    return "".join(f"{name}: {' '.join(f'{x:.12e}' for x in M.ravel())}\n" for name, M in matrices.items())


def _tensor(array: np.ndarray) -> o3d.core.Tensor:
    return o3d.core.Tensor(np.ascontiguousarray(array, dtype=np.float32))
