"""The text and binary files of KITTI's object benchmark (Geiger et al., CVPR 2012): boxes, calibration, scans."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from objgraph.datasets.files import read_bytes, rigid_or_reason
from objgraph.errors import DatasetError
from objgraph.observation.lidar.kitti_box import KittiBox

DONT_CARE = "DontCare"
_COLUMNS = 15


@dataclass(frozen=True)
class Calibration:
    """Where LiDAR and colour camera are, all in the rectified frame of camera 0."""

    K: Float[np.ndarray, "3 3"]
    """Of the colour camera, image_2."""
    T_rect_camera: Float[np.ndarray, "4 4"]
    """Pose of the colour camera: rectified, so it is only moved."""
    T_rect_velodyne: Float[np.ndarray, "4 4"]
    """The LiDAR's own axes: x ahead, y left, z up."""


def read_boxes(path: Path) -> tuple[KittiBox, ...]:
    """All lines but those of `DontCare`, which have no box; a file may be empty.

    Raises:
        DatasetError: the file is missing, or a line of it is damaged; the message names the line.
    """
    lines = enumerate(_lines(path), 1)
    boxes = [_box(line.split(), f"{path}, line {i}") for i, line in lines if line.strip()]
    return tuple(box for box in boxes if box.type != DONT_CARE)


def read_calibration(path: Path) -> Calibration:
    """Raises DatasetError where the file or one of P2, R0_rect and Tr_velo_to_cam is missing or damaged."""
    given = {}
    for line in _lines(path):
        # the tracking benchmark writes no colon behind R_rect and Tr_velo_cam
        name, *numbers = line.replace(":", " ", 1).split() or [""]
        given[name] = numbers
    P2 = _matrix(given, ("P2",), (3, 4), path)
    R0 = _matrix(given, ("R0_rect", "R_rect"), (3, 3), path)
    Tr = _matrix(given, ("Tr_velo_to_cam", "Tr_velo_cam"), (3, 4), path)
    K = P2[:, :3]
    if min(K[0, 0], K[1, 1]) <= 0 or not np.isclose(K[2, 2], 1.0):
        raise DatasetError(f"{path}: P2 is no camera's matrix; download the file again")
    T_rect_camera, T_rect_velodyne = np.eye(4), np.eye(4)
    T_rect_camera[:3, 3] = -np.linalg.solve(K, P2[:, 3])
    T_rect_velodyne[:3] = R0 @ Tr
    rigid = rigid_or_reason(T_rect_velodyne)
    if isinstance(rigid, str):
        raise DatasetError(
            f"{path}: R0_rect and Tr_velo_to_cam are no rigid motion: {rigid}; download the file again"
        )
    return Calibration(K, T_rect_camera, rigid)


def read_velodyne(path: Path) -> Float[np.ndarray, "n 3"]:
    """Returns in the LiDAR's own axes, metres, those that are not finite left out.

    Raises:
        DatasetError: the file is missing, no whole number of returns, or has none that is finite.
    """
    data = read_bytes(path)
    if not data:
        raise DatasetError(f"{path}: the scan is empty; download it again, or leave the frame out")
    if len(data) % 16:
        raise DatasetError(
            f"{path}: {len(data)} bytes are no whole number of returns of 16 bytes (x, y, z, reflectance as "
            "float32); the file is truncated or of another format"
        )
    return finite_returns(np.frombuffer(data, dtype="<f4").reshape(-1, 4)[:, :3].astype(float), path)


def finite_returns(points: Float[np.ndarray, "n 3"], path: Path) -> Float[np.ndarray, "m 3"]:
    """Those that are; raises DatasetError where none is."""
    finite = points[np.isfinite(points).all(axis=1)]
    if not len(finite):
        raise DatasetError(f"{path}: no return is finite; export the scan again, or leave the frame out")
    return finite


def _lines(path: Path) -> list[str]:
    return read_bytes(path).decode("utf-8-sig", errors="replace").splitlines()


def _box(words: list[str], where: str) -> KittiBox:
    if len(words) not in (_COLUMNS, _COLUMNS + 1):
        raise DatasetError(
            f"{where}: {len(words)} columns; KITTI's labels have {_COLUMNS} and a detector's results {_COLUMNS + 1}"
        )
    try:
        numbers = np.array([float(word) for word in words[1:]])
    except ValueError as error:
        raise DatasetError(f"{where}: {error}; the columns after the type must be numbers") from error
    if not np.isfinite(numbers).all():
        column = int(np.flatnonzero(~np.isfinite(numbers))[0]) + 1
        raise DatasetError(
            f"{where}: column {column + 1} is {words[column]}, no number; mend or delete the line"
        )
    truncation, occlusion, _, *rest = numbers
    height, width, length = rest[4:7]
    box = KittiBox(
        words[0], truncation, int(occlusion), np.array(rest[:4]), height, width, length, np.array(rest[7:10]),
        rest[10], rest[11] if len(rest) > 11 else None,
    )  # fmt: skip
    if box.type != DONT_CARE and not (box.size > 0).all():
        raise DatasetError(f"{where}: a {box.type} with edges {box.size} m is no box; delete the line")
    return box


def _matrix(
    given: dict[str, list[str]], names: tuple[str, ...], shape: tuple[int, int], path: Path
) -> np.ndarray:
    for name in names:
        if name in given:
            try:
                matrix = np.array([float(word) for word in given[name]]).reshape(shape)
            except ValueError as error:
                raise DatasetError(f"{path}: {name} is no {shape[0]}x{shape[1]} matrix ({error})") from error
            if not np.isfinite(matrix).all():
                raise DatasetError(f"{path}: {name} has numbers that are not finite; download the file again")
            return matrix
    raise DatasetError(f"{path}: has no {names[0]}; is it a calibration of the object benchmark?")
