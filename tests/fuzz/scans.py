"""Small good scans of every data set, each with a function that reads all of it."""

import json
import zipfile
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import open3d as o3d
import trimesh
from trimesh.exchange.obj import export_obj

from objgraph.datasets import kitti, lidar
from objgraph.datasets.registry import load_annotated, scenes
from objgraph.observation.frames import Frame
from objgraph.observation.lidar.frame import LidarFrame
from tests.objgraph.datasets import bag_files
from tests.objgraph.datasets import dataset_folders as folders
from tests.objgraph.datasets.test_boxes import write_icl

SHAPENET = Path("shapenet/ShapeNetCore.v2")
CAR = "Car 0.00 0 -1.57 600.00 150.00 700.00 250.00 1.50 1.60 4.00 1.00 1.65 12.00 0.10"
CALIBRATION = {
    "P2": "700 0 600 40 0 700 170 0.2 0 0 1 0.003",
    "R0_rect": "1 0 0 0 1 0 0 0 1",
    "Tr_velo_to_cam": "0 -1 0 0 0 0 -1 -0.08 1 0 0 -0.27",
}


def read_scan(dataset: str, root: Path) -> None:
    """Every frame, and all ground truth."""
    for scene in scenes(dataset, root):
        scan = load_annotated(dataset, root, scene)
        assert abs(np.linalg.norm(scan.up_world) - 1) < 1e-6
        for i in range(min(len(scan.frames), 5)):
            check(scan.frames[i])
        for truth in dict(scan.ground_truth).values():
            assert all(
                np.isfinite(each).all() for each in (truth.T_world_object, truth.scale, truth.vertices)
            )


def check(frame: Frame) -> None:
    """What is taken is a frame: finite depth, a rigid pose, a camera."""
    camera = vars(frame.intrinsics).values()
    assert np.isfinite([*camera]).all()
    assert min(frame.intrinsics.fx, frame.intrinsics.fy) > 0
    assert np.isfinite(frame.depth).all()
    assert (frame.depth >= 0).all()
    assert np.isfinite(frame.T_world_camera).all()
    assert np.allclose(frame.T_world_camera[:3, :3].T @ frame.T_world_camera[:3, :3], np.eye(3), atol=1e-6)
    assert frame.color is None or frame.color.shape[:2] == frame.depth.shape


def scan_of(dataset: str) -> Callable[[Path], None]:
    return lambda root: read_scan(dataset, root)


def write_folder_of_texts(root: Path) -> None:
    """Run lengths and polygons for masks, a matrix a frame for poses, a text for the camera."""
    folder = folders.write_plain_folder(root, folders.toy_scan(2))
    (folder / "poses.txt").unlink()
    (folder / "intrinsics.json").unlink()
    (folder / "intrinsics.txt").write_text("60 60 31.5 23.5\n")
    for k, path in enumerate(sorted((folder / "masks").iterdir())):
        path.unlink()
        runs = {"size": [48, 64], "counts": [490, 20, 28, 2534]}
        square = [[20, 10, 40, 10, 40, 30, 20, 30]]
        masks = [{"segmentation": runs, "instance_id": 1}, {"segmentation": square, "id": 3}]
        path.with_suffix(".json").write_text(json.dumps(masks))
        folders.write_matrix(folder / "pose" / f"{path.stem}.txt", folders.pose(k))


def write_annotated(root: Path) -> None:
    """ScanNet's folders with masks in an archive, sizes in a text, and Scan2CAD beside them."""
    folder = folders.write_exported_scan(root / "scannet", 2)
    (folder / f"{folder.name}.txt").write_text("depthShift = 1000\ndepthWidth = 64\ndepthHeight = 48\n")
    with zipfile.ZipFile(folder / f"{folder.name}_2d-instance-filt.zip", "w", zipfile.ZIP_DEFLATED) as file:
        for path in sorted((folder / "instance-filt").iterdir()):
            file.write(path, f"instance-filt/{path.name}")
            path.unlink()
    (folder / "instance-filt").rmdir()
    box = trimesh.creation.box([0.7, 0.7, 0.7])
    path = root / SHAPENET / "03001627/aa/models/model_normalized.obj"
    folders.write_bytes(path, ("mtllib absent.mtl\n" + export_obj(box)).encode())
    still = {"translation": [0, 0, 0], "rotation": [1, 0, 0, 0], "scale": [1, 1, 1]}
    placed = {**still, "translation": [0, 0, 2.5]}
    model = {"trs": placed, "catid_cad": "03001627", "id_cad": "aa", "sym": "__SYM_NONE"}
    entry = {"id_scan": folders.SCENE, "trs": still, "aligned_models": [model]}
    folders.write_bytes(root / "scan2cad/full_annotations.json", json.dumps([entry]).encode())


def write_kitti(root: Path) -> None:
    training = root / "training"
    calibration = "".join(f"{name}: {numbers}\n" for name, numbers in CALIBRATION.items())
    points = np.random.default_rng(0).normal(size=(50, 4)).astype("<f4")
    folders.write_bytes(training / "velodyne/000000.bin", points.tobytes())
    folders.write_bytes(training / "calib/000000.txt", calibration.encode())
    folders.write_bytes(training / "label_2/000000.txt", f"{CAR}\n".encode())
    folders.write_bytes(root / "detections/000000.txt", f"{CAR} 0.9\n{CAR} 0.8\n".encode())
    folders.write_bytes(training / "image_2/000000.png", folders.png(folders.color_image()))
    folders.write_bytes(root / "masks/000000.png", folders.png(folders.mask_image()))


def read_kitti(root: Path) -> None:
    for name in kitti.frames(root):
        check_lidar(kitti.load_frame(root, name))
        kitti.load_labels(root, name)


def read_lidar(root: Path) -> None:
    check_lidar(lidar.load_frame(root))


def check_lidar(frame: LidarFrame) -> None:
    arrays = [frame.p_lidar, frame.T_world_lidar]
    for each in frame.detections:
        arrays += [each.T_world_object, each.size]
        assert each.size.min() > 0
    assert all(np.isfinite(array).all() for array in arrays)


def points_in(form: str) -> bytes:
    """Twenty points as "bin", "ply", "ascii.ply", "pcd", "ascii.pcd" or "compressed.pcd"."""
    points = np.random.default_rng(0).normal(size=(20, 3)).round(2)
    if form == "bin":
        return np.column_stack([points, np.ones(20)]).astype("<f4").tobytes()
    if form.endswith("ply"):
        encoding = "ascii" if "ascii" in form else "binary"
        return trimesh.PointCloud(points).export(file_type="ply", encoding=encoding)  # type: ignore[return-value]
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
    with TemporaryDirectory() as folder:
        path = Path(folder) / "points.pcd"
        o3d.io.write_point_cloud(str(path), cloud, "pcd", "ascii" in form, "compressed" in form)
        return path.read_bytes()


def write_lidar(root: Path, form: str) -> None:
    box = {"category": "car", "centre": [9.0, 2.0, -1.0], "size": [4.0, 1.6, 1.5], "yaw": 0.3, "score": 0.9}
    folders.write_bytes(root / "detections.json", json.dumps({"boxes": [box]}).encode())
    folders.write_bytes(root / f"points.{form.rpartition('.')[2]}", points_in(form))


def of_toy(write: Callable[..., Path], count: int = 2) -> Callable[[Path], object]:
    return lambda root: write(
        root / "a" if write is folders.write_tum_sequence else root, folders.toy_scan(count)
    )


def of_lidar(form: str) -> tuple[Callable[[Path], object], Callable[[Path], object]]:
    return lambda root: write_lidar(root, form), read_lidar


def of_bag(kind: str, **forms: str) -> Callable[[Path], object]:
    return lambda root: bag_files.write_recording(root, folders.toy_scan(2), kind, **forms)


SCANS: dict[str, tuple[Callable[[Path], object], Callable[[Path], object]]] = {
    "folder": (of_toy(folders.write_plain_folder), scan_of("folder")),
    "folder of texts": (write_folder_of_texts, scan_of("folder")),
    "tum": (of_toy(folders.write_tum_sequence), scan_of("tum")),
    "nerfstudio": (of_toy(folders.write_nerfstudio), scan_of("nerfstudio")),
    "bop": (of_toy(folders.write_bop), scan_of("bop")),
    "sens": (
        lambda root: folders.write_sens_scan(root, folders.sens_bytes(2)),
        scan_of("scannet"),
    ),
    "scannet": (write_annotated, lambda root: read_scan("scannet", root / "scannet")),
    "sevenscenes": (lambda root: folders.write_seven_scenes(root, 2), scan_of("sevenscenes")),
    "icl": (write_icl, scan_of("icl")),
    "kitti": (write_kitti, read_kitti),
    "bag": (of_bag("bag"), scan_of("bag")),
    "mcap": (of_bag("mcap", how="odometry", depth="compressedDepth", color="jpeg"), scan_of("bag")),
    "db3": (of_bag("db3", how="pose", depth="32FC1"), scan_of("bag")),
    **{
        f"lidar {form}": of_lidar(form)
        for form in ("bin", "ply", "ascii.ply", "pcd", "ascii.pcd", "compressed.pcd")
    },
}
"""What writes each into a folder, and what reads it."""
