"""Tiny data sets made up for the tests: a plane two metres before the camera and a box-shaped object on it."""

import json
import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from objgraph.datasets.files import LazyFrames
from objgraph.datasets.trajectory import Trajectory, write_tum
from objgraph.observation.frames import Frame, Instance, Intrinsics, Scan

WIDTH, HEIGHT = 64, 48
FOCAL = 60.0
SCENE = "scene0001_00"
LABELS = {0: "office chair", 1: "trash can", 2: "desk"}


def camera_matrix(width: int = WIDTH, height: int = HEIGHT, focal: float = FOCAL) -> np.ndarray:
    matrix = np.eye(4)
    matrix[0, 0] = matrix[1, 1] = focal
    matrix[0, 2], matrix[1, 2] = (width - 1) / 2, (height - 1) / 2
    return matrix


def depth_image(index: int = 0) -> np.ndarray:
    """Millimetres; 0 and 65535 where there is no depth."""
    depth = np.full((HEIGHT, WIDTH), 2000, dtype=np.uint16)
    depth[10:30, 20:40] = 1500 + index
    depth[0, 0], depth[0, 1] = 0, 65535
    return depth


def mask_image() -> np.ndarray:
    mask = np.zeros((HEIGHT, WIDTH), dtype=np.uint8)
    mask[10:30, 20:30] = 1
    mask[10:30, 30:40] = 3
    return mask


def color_image(index: int = 0, scale: int = 1) -> np.ndarray:
    """BGR, one colour, so that JPEG keeps it: mostly red."""
    return np.full((scale * HEIGHT, scale * WIDTH, 3), (20, 40, 200 + index), dtype=np.uint8)


def pose(index: int = 0) -> np.ndarray:
    matrix = np.eye(4)
    angle = 0.1 * index
    matrix[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    matrix[:3, 3] = [0.1 * index, 0, 1]
    return matrix


def png(image: np.ndarray) -> bytes:
    return cv2.imencode(".png", image)[1].tobytes()


def jpeg(image: np.ndarray) -> bytes:
    return cv2.imencode(".jpg", image)[1].tobytes()


def write_bytes(path: Path, data: bytes) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(data)


def write_matrix(path: Path, matrix: np.ndarray) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savetxt(path, matrix)


def write_labels(folder: Path, suffix: str = "") -> None:
    groups = [{"id": k, "objectId": k, "segments": [k], "label": label} for k, label in LABELS.items()]
    write_bytes(
        folder / f"{folder.name}{suffix}.aggregation.json", json.dumps({"segGroups": groups}).encode()
    )


def write_exported_scan(root: Path, count: int = 3, scene: str = SCENE) -> Path:
    """A scan in the folders that ScanNet's SensReader exports; gives the scan's folder."""
    folder = root / "scans" / scene
    for k in range(count):
        write_bytes(folder / "color" / f"{k}.jpg", jpeg(color_image(k, scale=2)))
        write_bytes(folder / "depth" / f"{k}.png", png(depth_image(k)))
        write_bytes(folder / "instance-filt" / f"{k}.png", png(mask_image()))
        write_matrix(folder / "pose" / f"{k}.txt", pose(k))
    write_matrix(folder / "intrinsic" / "intrinsic_depth.txt", camera_matrix())
    write_labels(folder)
    return folder


def sens_bytes(
    count: int = 3,
    version: int = 4,
    color_compression: int = 2,
    depth_compression: int = 1,
    depth_shift: float = 1000.0,
) -> bytes:
    """A scan as ScanNet's SensorData, version 4."""
    name = b"StructureSensor"
    parts = [struct.pack("<IQ", version, len(name)), name]
    for matrix in (camera_matrix(2 * WIDTH, 2 * HEIGHT), np.eye(4), camera_matrix(), np.eye(4)):
        parts.append(matrix.astype("<f4").tobytes())
    parts.append(
        struct.pack("<ii4I", color_compression, depth_compression, 2 * WIDTH, 2 * HEIGHT, WIDTH, HEIGHT)
    )
    parts.append(struct.pack("<fQ", depth_shift, count))
    for k in range(count):
        color, depth = jpeg(color_image(k, scale=2)), depth_image(k).astype("<u2").tobytes()
        depth = zlib.compress(depth) if depth_compression == 1 else depth
        parts.append(pose(k).astype("<f4").tobytes())
        parts.append(struct.pack("<4Q", 10 * k, 10 * k, len(color), len(depth)))
        parts.extend([color, depth])
    parts.append(struct.pack("<Q", 0))  # no inertial measurements
    return b"".join(parts)


def write_sens_scan(root: Path, data: bytes, scene: str = SCENE) -> Path:
    """A scan as the `.sens` file with masks in a folder; gives the scan's folder."""
    folder = root / "scans" / scene
    write_bytes(folder / f"{scene}.sens", data)
    for k in range(3):
        write_bytes(folder / "instance-filt" / f"{k}.png", png(mask_image()))
    write_labels(folder)
    return folder


def write_seven_scenes(root: Path, count: int = 3, scene: str = "office") -> Path:
    """A 7-Scenes sequence whose one box holds the object before the plane; gives its folder."""
    folder = root / scene
    for k in range(count):
        write_bytes(folder / f"frame-{k:06d}.color.jpg", jpeg(color_image(k)))
        write_bytes(folder / f"frame-{k:06d}.depth.png", png(depth_image(k)))
        write_matrix(folder / f"frame-{k:06d}.pose.txt", pose(0))
    write_matrix(folder / "camera-intrinsics.txt", camera_matrix()[:3, :3])
    box = {"centre": [0, 0, 2.5], "rotation": np.eye(3).tolist(), "size": [4, 4, 0.2]}
    objects = [{"id": 0, "label": "chair", **box}, {"id": 1, "label": "plant", **box}]
    content = {"up": [0, 0, -2.0], "floor_d": 10.0, "objects": objects}
    write_bytes(folder / "instances.json", json.dumps(content).encode())
    return folder


def toy_scan(count: int = 3) -> Scan:
    """The plane and its object in memory, with a world whose z is up."""
    camera = Intrinsics(FOCAL, FOCAL, (WIDTH - 1) / 2, (HEIGHT - 1) / 2, WIDTH, HEIGHT)

    def frame(name: str) -> Frame:
        k = int(name)
        depth = np.where(depth_image(k) == 65535, 0, depth_image(k) / 1000)
        color = np.ascontiguousarray(color_image(k)[..., ::-1])
        return Frame(name, depth, camera, pose(k), mask_image().astype(np.int32), color)

    instances = (Instance(1, "chair"), Instance(3, "table"))
    return Scan(
        "toy", LazyFrames([f"{k:06d}" for k in range(count)], frame), instances, np.array([0, 0, 1.0])
    )


def frames_of(scan: Scan) -> list[Frame]:
    return [scan.frames[k] for k in range(len(scan.frames))]


def write_instances(folder: Path, scan: Scan) -> None:
    instances = {str(instance.id): instance.category for instance in scan.instances}
    content = {"up_world": scan.up_world.tolist(), "instances": instances}
    write_bytes(folder / "instances.json", json.dumps(content).encode())


def write_plain_folder(folder: Path, scan: Scan, depth_scale: float = 1000.0) -> Path:
    """A scan in the plain layout, poses in `poses.txt` by frame name; gives the folder."""
    lines = []
    for frame in frames_of(scan):
        write_bytes(folder / "depth" / f"{frame.name}.png", depth_png(frame, depth_scale))
        write_bytes(folder / "masks" / f"{frame.name}.png", png(frame.instances.astype(np.uint8)))
        write_bytes(folder / "color" / f"{frame.name}.png", color_png(frame))
        lines.append((frame.name, tum_words(frame.T_world_camera)))
        camera = frame.intrinsics
    write_bytes(folder / "poses.txt", "".join(f"{name} {words}\n" for name, words in lines).encode())
    content = {key: getattr(camera, key) for key in ("fx", "fy", "cx", "cy", "width", "height")}
    write_bytes(folder / "intrinsics.json", json.dumps(content | {"depth_scale": depth_scale}).encode())
    write_instances(folder, scan)
    return folder


def write_tum_sequence(folder: Path, scan: Scan, color_delay: float = 0.007, mask: str = "depth") -> Path:
    """A scan as a TUM sequence at 30 Hz, its masks named by the `depth` or the `rgb` image; gives the folder."""
    frames = frames_of(scan)
    times = [1305031102.1604 + k / 30 for k in range(len(frames))]
    lists: dict[str, list[str]] = {"depth": ["# depth maps"], "rgb": ["# color images"]}
    for time, frame in zip(times, frames, strict=True):
        names = {"depth": f"{time:.6f}", "rgb": f"{time + color_delay:.6f}"}
        for kind, data in (("depth", depth_png(frame, 5000)), ("rgb", color_png(frame))):
            write_bytes(folder / kind / f"{names[kind]}.png", data)
            lists[kind].append(f"{names[kind]} {kind}/{names[kind]}.png")
        write_bytes(folder / "masks" / f"{names[mask]}.png", png(frame.instances.astype(np.uint8)))
        camera = frame.intrinsics
    for kind, lines in lists.items():
        write_bytes(folder / f"{kind}.txt", "\n".join(lines).encode())
    write_tum(folder / "groundtruth.txt", dense_trajectory(times, [frame.T_world_camera for frame in frames]))
    numbers = (camera.fx, camera.fy, camera.cx, camera.cy)
    write_bytes(folder / "intrinsics.txt", " ".join(map(repr, numbers)).encode())
    write_instances(folder, scan)
    return folder


def write_nerfstudio(folder: Path, scan: Scan) -> Path:
    """A scan in nerfstudio's layout; gives the folder."""
    entries = []
    for k, frame in enumerate(frames_of(scan)):
        color, depth = f"images/frame_{k:05d}.png", f"depths/depth_{k:05d}.png"
        write_bytes(folder / color, color_png(frame))
        write_bytes(folder / depth, depth_png(frame, 1000))
        write_bytes(folder / "masks" / f"frame_{k:05d}.png", png(frame.instances.astype(np.uint8)))
        T_world_opengl = frame.T_world_camera @ np.diag([1, -1, -1, 1])
        paths = {"file_path": color, "depth_file_path": depth}
        entries.append(paths | {"transform_matrix": T_world_opengl.tolist()})
        camera = frame.intrinsics
    content = {"camera_model": "OPENCV", "fl_x": camera.fx, "fl_y": camera.fy, "k1": 0.0}
    content |= {"cx": camera.cx + 0.5, "cy": camera.cy + 0.5, "w": camera.width, "h": camera.height}
    write_bytes(folder / "transforms.json", json.dumps(content | {"frames": entries}).encode())
    write_instances(folder, scan)
    return folder


def write_bop(folder: Path, scan: Scan, objects: dict[int, int] | None = None) -> Path:
    """A scan as a BOP scene; `objects` gives an object id to each instance, by default its own; gives the folder."""
    objects = objects or {instance.id: instance.id for instance in scan.instances}
    cameras, truth = {}, {}
    for k, frame in enumerate(frames_of(scan)):
        write_bytes(folder / "rgb" / f"{k:06d}.png", color_png(frame))
        write_bytes(folder / "depth" / f"{k:06d}.png", depth_png(frame, 10_000))
        order = [i for i in (objects if k % 2 else reversed(objects)) if (frame.instances == i).any()]
        for m, i in enumerate(order):
            mask = 255 * (frame.instances == i).astype(np.uint8)
            write_bytes(folder / "mask_visib" / f"{k:06d}_{m:06d}.png", png(mask))
        T, c = np.linalg.inv(frame.T_world_camera), frame.intrinsics
        cameras[str(k)] = {
            "cam_K": [c.fx, 0, c.cx, 0, c.fy, c.cy, 0, 0, 1],
            "cam_R_w2c": T[:3, :3].ravel().tolist(),
            "cam_t_w2c": (1000 * T[:3, 3]).tolist(),
            "depth_scale": 0.1,
        }
        truth[str(k)] = [{"obj_id": objects[i]} for i in order]
    write_bytes(folder / "scene_camera.json", json.dumps(cameras).encode())
    write_bytes(folder / "scene_gt.json", json.dumps(truth).encode())
    categories = {str(objects[each.id]): each.category for each in scan.instances}
    content = {"up_world": scan.up_world.tolist(), "instances": categories}
    write_bytes(folder / "instances.json", json.dumps(content).encode())
    return folder


def dense_trajectory(times: list[float], poses: list[np.ndarray]) -> Trajectory:
    """Each pose a millisecond after its time, and one that is nobody's 11 ms after it."""
    stamps = np.concatenate([np.array(times) + 0.001, np.array(times) + 0.011])
    order = np.argsort(stamps)
    return Trajectory(stamps[order], np.array([*poses, *([np.eye(4)] * len(poses))])[order])


def tum_words(T: np.ndarray) -> str:
    """`tx ty tz qx qy qz qw` of a pose."""
    return " ".join(map(repr, [*T[:3, 3].tolist(), *Rotation.from_matrix(T[:3, :3]).as_quat().tolist()]))


def depth_png(frame: Frame, units_a_metre: float) -> bytes:
    return png(np.round(frame.depth * units_a_metre).astype(np.uint16))


def color_png(frame: Frame) -> bytes:
    assert frame.color is not None
    return png(np.ascontiguousarray(frame.color[..., ::-1]))


def assert_scans_equal(read: Scan, scan: Scan, quantum: float) -> None:
    """The same frames, objects and gravity: depth to half a `quantum`, poses to 1e-6."""
    assert read.instances == scan.instances
    np.testing.assert_allclose(read.up_world, scan.up_world, atol=1e-12)
    assert len(read.frames) == len(scan.frames) > 0
    for mine, theirs in zip(frames_of(read), frames_of(scan), strict=True):
        np.testing.assert_allclose(mine.depth, theirs.depth, atol=quantum / 2 + 1e-12)
        np.testing.assert_array_equal(mine.instances, theirs.instances)
        np.testing.assert_array_equal(mine.color, theirs.color)
        np.testing.assert_allclose(mine.T_world_camera, theirs.T_world_camera, atol=1e-6)
        assert mine.intrinsics == theirs.intrinsics
