"""The sample scene as files: ScanNet's layout, Scan2CAD's annotations and ShapeNet's models."""

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import trimesh
from jaxtyping import Float, Int, UInt8
from scipy.spatial.transform import Rotation

from objgraph.synthetic.furniture import Furniture
from objgraph.synthetic.scene import PlacedFurniture

CATALOGUE = {"chair": "03001627", "table": "04379243"}
"""ShapeNet's synset of each category."""
_SYMMETRY = {1: "__SYM_NONE", 2: "__SYM_ROTATE_UP_2", 4: "__SYM_ROTATE_UP_4", 0: "__SYM_ROTATE_UP_INF"}
_MILLIMETRES = 1000.0
# the annotations' own world has y up and another origin than the scan, as Scan2CAD's have
_T_ANNOTATION_SCAN = np.array(
    [[1.0, 0.0, 0.0, -0.35], [0.0, 0.0, 1.0, -0.62], [0.0, -1.0, 0.0, 0.8], [0.0, 0.0, 0.0, 1.0]]
)


def write_frame(
    scan: Path,
    index: int,
    color: UInt8[np.ndarray, "h w 3"],
    depth: Float[np.ndarray, "h w"],
    instances: Int[np.ndarray, "h w"],
    T_world_camera: Float[np.ndarray, "4 4"],
) -> None:
    """One frame into the folders of a scan; depth in metres, instances as objectId + 1."""
    for folder in ("color", "depth", "instance-filt", "pose"):
        (scan / folder).mkdir(parents=True, exist_ok=True)
    _write_image(scan / "color" / f"{index}.jpg", color[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 90])
    _write_image(scan / "depth" / f"{index}.png", np.round(depth * _MILLIMETRES).astype(np.uint16))
    _write_image(scan / "instance-filt" / f"{index}.png", instances.astype(np.uint8))
    _write_matrix(scan / "pose" / f"{index}.txt", T_world_camera)


def write_scan_description(
    scan: Path,
    pieces: list[PlacedFurniture],
    camera: Float[np.ndarray, "3 3"],
    size: tuple[int, int],
    frames: int,
) -> None:
    """Intrinsics, the text header and the list of objects; `size` is (width, height)."""
    (scan / "intrinsic").mkdir(parents=True, exist_ok=True)
    matrix = np.eye(4)
    matrix[:3, :3] = camera
    for sensor in ("color", "depth"):
        _write_matrix(scan / "intrinsic" / f"intrinsic_{sensor}.txt", matrix)
        _write_matrix(scan / "intrinsic" / f"extrinsic_{sensor}.txt", np.eye(4))
    (scan / f"{scan.name}.txt").write_text(_header(camera, size, frames))
    groups = [
        {"id": i, "objectId": i, "segments": [i + 1], "label": placed.piece.category}
        for i, placed in enumerate(pieces)
    ]
    content = {"sceneId": f"scannet.{scan.name}", "appId": "objgraph.synthetic", "segGroups": groups}
    _write_json(scan / f"{scan.name}.aggregation.json", content)


def write_ground_truth(root: Path, name: str, pieces: list[PlacedFurniture]) -> None:
    """Scan2CAD's annotation of the scan `name` and the models that it refers to."""
    models = []
    for index, placed in enumerate(pieces):
        model_id = f"{name}-{index}-{placed.piece.family}"
        models.append(_annotation(placed, model_id))
        folder = (
            root / "shapenet" / "ShapeNetCore.v2" / CATALOGUE[placed.piece.category] / model_id / "models"
        )
        folder.mkdir(parents=True)
        (folder / "model_normalized.obj").write_text(_wavefront(placed.piece.mesh))
    entry = {
        "id_scan": name,
        "trs": _trs(_T_ANNOTATION_SCAN, np.ones(3)),
        "n_aligned_models": len(models),
        "aligned_models": models,
    }
    (root / "scan2cad").mkdir(parents=True)
    _write_json(root / "scan2cad" / "full_annotations.json", [entry])


def _annotation(placed: PlacedFurniture, model_id: str) -> dict[str, Any]:
    piece: Furniture = placed.piece
    return {
        "trs": _trs(_T_ANNOTATION_SCAN @ placed.T_world_object, placed.scale),
        "bbox": (piece.mesh.extents / 2).tolist(),
        "center": piece.mesh.bounds.mean(axis=0).tolist(),
        "sym": _SYMMETRY[piece.symmetry],
        "id_cad": model_id,
        "catid_cad": CATALOGUE[piece.category],
        "keypoints_cad": {"n_keypoints": 0, "position": []},
        "keypoints_scan": {"n_keypoints": 0, "position": []},
    }


def _trs(T: Float[np.ndarray, "4 4"], scale: Float[np.ndarray, "3"]) -> dict[str, list[float]]:
    quaternion = Rotation.from_matrix(T[:3, :3]).as_quat(canonical=True, scalar_first=True)
    return {"translation": T[:3, 3].tolist(), "rotation": quaternion.tolist(), "scale": scale.tolist()}


def _wavefront(mesh: trimesh.Trimesh) -> str:
    lines = [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in mesh.vertices]
    lines += [f"f {a} {b} {c}" for a, b, c in np.asarray(mesh.faces) + 1]
    return "\n".join(lines) + "\n"


def _header(camera: np.ndarray, size: tuple[int, int], frames: int) -> str:
    identity = " ".join(f"{value:.6f}" for value in np.eye(4).ravel())
    values: dict[str, object] = {"axisAlignment": identity, "colorToDepthExtrinsics": identity}
    for sensor in ("color", "depth"):
        values |= {f"{sensor}Width": size[0], f"{sensor}Height": size[1]}
        values |= {f"fx_{sensor}": f"{camera[0, 0]:.6f}", f"fy_{sensor}": f"{camera[1, 1]:.6f}"}
        values |= {f"mx_{sensor}": f"{camera[0, 2]:.6f}", f"my_{sensor}": f"{camera[1, 2]:.6f}"}
        values[f"num{sensor.capitalize()}Frames"] = frames
    return "".join(f"{key} = {values[key]}\n" for key in sorted(values)) + "sceneType = Synthetic\n"


def _write_matrix(path: Path, matrix: np.ndarray) -> None:
    path.write_text("".join(" ".join(f"{value:.8f}" for value in row) + "\n" for row in matrix))


def _write_json(path: Path, content: Any) -> None:
    path.write_text(json.dumps(content, indent=1) + "\n")


def _write_image(path: Path, image: np.ndarray, options: list[int] | None = None) -> None:
    ok, data = cv2.imencode(path.suffix, image, options or [])
    if not ok:
        raise OSError(f"{path}: the image could not be encoded")
    path.write_bytes(data.tobytes())
