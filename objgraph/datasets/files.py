"""What the loaders share: reading images, matrices and JSON with errors that name the file, and lazy frames."""

import logging
from collections.abc import Callable, Sequence
from io import BytesIO
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from jaxtyping import Float, Int, UInt8
from PIL import Image

from objgraph.checked import parse_json
from objgraph.errors import DatasetError
from objgraph.geometry.frames import why_not_rigid
from objgraph.observation.frames import Frame, FrameSource, Intrinsics

log = logging.getLogger(__name__)

MOST_PIXELS = 8 * 10**7
"""Of an image; what Pillow warns of is larger."""
_ROUNDED = 0.02
"""Share by which images of one view may differ in proportion."""
_UNREADABLE = "{}: no readable image (PNG or JPEG; truncated or damaged); download or export it again"
_PNG, _PNG_BITS, _PNG_KIND = b"\x89PNG\r\n\x1a\n", 24, 25
"""How a PNG begins, the byte that says how many bits a channel has, and the one that says what its pixels are."""
_PALETTE = 3
_INVALID_DEPTH = np.iinfo(np.uint16).max


class LazyFrames(FrameSource):
    """Frames that a function reads when they are asked for; nothing is kept."""

    def __init__(self, names: Sequence[str], read: Callable[[str], Frame]) -> None:
        self._names = tuple(names)
        self._read = read

    @property
    def names(self) -> tuple[str, ...]:
        return self._names

    def __len__(self) -> int:
        return len(self._names)

    def __getitem__(self, index: int) -> Frame:
        return self._read(self._names[index])


def read_bytes(path: Path) -> bytes:
    """The file's content; `DatasetError` where it is missing or unreadable."""
    try:
        return path.read_bytes()
    except OSError as error:
        raise DatasetError(f"{path}: cannot be read ({error.strerror}); is the data set complete?") from error


def read_json(path: Path) -> Any:
    """A document, which may hold NaN and infinity; raises `DatasetError`."""
    try:
        return parse_json(read_bytes(path), finite=False)
    except ValueError as error:
        raise DatasetError(f"{path}: no valid JSON ({error}); mend it or download it again") from error


def read_matrix(path: Path, rows: int, columns: int) -> np.ndarray:
    """A matrix of numbers in text; it may hold NaN and infinity."""
    text = read_bytes(path).decode("utf-8-sig", errors="replace")
    try:
        matrix = np.array([float(word) for word in text.split()])
    except ValueError as error:
        raise DatasetError(f"{path}: no matrix of numbers ({error})") from error
    if matrix.size != rows * columns:
        raise DatasetError(f"{path}: holds {matrix.size} numbers instead of a {rows}x{columns} matrix")
    return matrix.reshape(rows, columns)


class ColorImages:
    """A scan's colour images, which are for display alone: one that cannot be used is None, and the first is warned of."""

    def __init__(self) -> None:
        self._warned = False

    def read(self, path: Path | None, shape: tuple[int, int]) -> UInt8[np.ndarray, "h w 3"] | None:
        """RGB as large as `shape` (height, width); None without a path, too."""
        return None if path is None else self.made(lambda: decode_color(read_bytes(path), path), path, shape)

    def made(
        self, decode: Callable[[], UInt8[np.ndarray, "a b 3"]], origin: object, shape: tuple[int, int]
    ) -> UInt8[np.ndarray, "h w 3"] | None:
        """The same of what a function gives, which may raise `DatasetError`."""
        try:
            color = decode()
            check_proportions("colour image", origin, (color.shape[0], color.shape[1]), shape)
        except DatasetError as error:
            if not self._warned:
                log.warning("%s; colour is for display, and is not shown where it cannot be used", error)
            self._warned = True
            return None
        return fitted(color, shape)


def decode_color(data: bytes, origin: object) -> UInt8[np.ndarray, "h w 3"]:
    """RGB, as it lies in the file: depth and masks know nothing of the turn that a camera notes beside it."""
    flags = cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION
    return cv2.cvtColor(_decode(data, origin, flags), cv2.COLOR_BGR2RGB).astype(np.uint8)


def fitted(color: UInt8[np.ndarray, "a b 3"], shape: tuple[int, int]) -> UInt8[np.ndarray, "h w 3"]:
    """A colour image as large as `shape` (height, width)."""
    if color.shape[:2] == shape:
        return color
    return cv2.resize(color, shape[::-1], interpolation=cv2.INTER_AREA).astype(np.uint8)


def decode_depth(data: bytes, origin: object, shift: float) -> Float[np.ndarray, "h w"]:
    """Metres from a 16-bit image; see `metric_depth`."""
    raw = _decode(data, origin, cv2.IMREAD_UNCHANGED)
    if raw.dtype != np.uint16 or raw.ndim != 2:
        raise DatasetError(
            f"{origin}: depth must be a 16-bit one-channel image, not {raw.dtype} {raw.shape}; "
            "write round(1000 * metres) as uint16"
        )
    return metric_depth(raw, shift)


def metric_depth(raw: np.ndarray, shift: float) -> Float[np.ndarray, "h w"]:
    """Metres from integer depth of `shift` units a metre; 0 and 65535 both mean no depth and become 0."""
    return np.where(raw == _INVALID_DEPTH, 0.0, raw / shift)


def decode_instances(data: bytes, origin: object, shape: tuple[int, int]) -> Int[np.ndarray, "h w"]:
    """Instance ids of a PNG of 8 or 16 bits: JPEG blurs them, fewer bits are stretched to 0..255, and a palette's are colours; see
    `decode_mask`."""
    if data.startswith(_PNG) and data[_PNG_KIND : _PNG_KIND + 1] == bytes([_PALETTE]):
        raise DatasetError(
            f"{origin}: a mask with a palette of colours; write the palette's indices, if they are the ids, as grey values "
            "(Pillow: Image.fromarray(np.array(image)))"
        )
    ids = decode_mask(data, origin, shape)
    bits = data[_PNG_BITS] if data.startswith(_PNG) else None
    if bits is None or bits < 8:
        what = "that is a JPEG" if bits is None else f"of {bits} bit"
        raise DatasetError(f"{origin}: a mask {what} does not keep ids; write it as a PNG of 8 or 16 bits")
    return ids


def decode_mask(data: bytes, origin: object, shape: tuple[int, int]) -> Int[np.ndarray, "h w"]:
    """A mask's values; an image of the colour camera's resolution is resized by nearest neighbour to `shape`.

    A mask whose proportions differ from those of `shape` by more than 2 % belongs to another camera and
    raises `DatasetError`.
    """
    ids = _decode(data, origin, cv2.IMREAD_UNCHANGED)
    if ids.ndim != 2 or ids.dtype not in (np.uint8, np.uint16):
        raise DatasetError(
            f"{origin}: a mask must be a one-channel integer image, not {ids.dtype} {ids.shape}"
        )
    return fitted_ids(ids, origin, shape)


def fitted_ids(ids: np.ndarray, origin: object, shape: tuple[int, int]) -> Int[np.ndarray, "h w"]:
    """Instance ids as large as `shape`; see `decode_mask`."""
    if ids.shape != shape:
        check_proportions("mask", origin, (ids.shape[0], ids.shape[1]), shape)
        ids = cv2.resize(ids, shape[::-1], interpolation=cv2.INTER_NEAREST_EXACT)
    return ids.astype(np.int32)


def same_proportions(shape: tuple[int, int], other: tuple[int, int]) -> bool:
    """Whether heights and widths differ in proportion by no more than rounding does."""
    return abs(shape[1] / shape[0] * other[0] / other[1] - 1) <= _ROUNDED


def check_proportions(what: str, origin: object, shape: tuple[int, int], depth: tuple[int, int]) -> None:
    """Raise `DatasetError` where an image (height, width) cannot be of the depth image's view."""
    if not same_proportions(shape, depth):
        raise DatasetError(
            f"{origin}: the {what} is {shape[1]}x{shape[0]} pixels and the depth image "
            f"{depth[1]}x{depth[0]}: other proportions, so not the same view"
        )


def rigid_or_reason(matrix: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "4 4"] | str:
    """The pose with its rotation made exactly orthonormal, or why it is none."""
    if (why := why_not_rigid(matrix)) is not None:
        return why
    u, _, vt = np.linalg.svd(matrix[:3, :3])
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = u @ vt, matrix[:3, 3]
    return pose


def usable_poses(
    names: Sequence[str], read: Callable[[str], Float[np.ndarray, "4 4"]], folder: Path
) -> dict[str, Float[np.ndarray, "4 4"]]:
    """T_world_camera by frame name, without the frames that have none; each of these is logged.

    Raises `DatasetError` where no frame remains.
    """
    poses = {}
    for name in names:
        try:
            pose = rigid_or_reason(read(name))
        except DatasetError as error:
            pose = str(error)
        if isinstance(pose, str):
            log.warning("%s: frame %s is left out, its pose cannot be used: %s", folder, name, pose)
        else:
            poses[name] = pose
    if not poses:
        raise DatasetError(f"{folder}: none of the {len(names)} frames has depth and a usable pose")
    return poses


def intrinsics_from(
    matrix: Float[np.ndarray, "r c"],
    origin: object,
    width: int,
    height: int,
    size: tuple[int, int] | None = None,
) -> Intrinsics:
    """A camera of `width` x `height` pixels from its matrix.

    `size` (width, height) is the resolution that the matrix was made for, where the data set says it: the
    matrix is scaled to the image. Where it does not, a principal point more than a tenth of the image away
    from the middle raises `DatasetError`: the matrix is for another resolution.
    """
    fx, fy, cx, cy = matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2]
    if not np.isfinite([fx, fy, cx, cy]).all() or min(fx, fy) <= 0:
        raise DatasetError(f"{origin}: no camera matrix (fx {fx}, fy {fy}, cx {cx}, cy {cy})")
    if size is not None and min(size) < 1:
        raise DatasetError(
            f"{origin}: the intrinsics are for images of {size[0]}x{size[1]} pixels: there are none"
        )
    if size is not None and size != (width, height):
        sx, sy = width / size[0], height / size[1]
        if not same_proportions((height, width), (size[1], size[0])):
            raise DatasetError(
                f"{origin}: the intrinsics are for {size[0]}x{size[1]} pixels, the images have {width}x{height}: "
                "other proportions, so scaling cannot bring them together"
            )
        # pixel centres lie at integers, so the image's corner is at -0.5
        fx, fy, cx, cy = fx * sx, fy * sy, (cx + 0.5) * sx - 0.5, (cy + 0.5) * sy - 0.5
    if abs(cx - (width - 1) / 2) > 0.1 * width or abs(cy - (height - 1) / 2) > 0.1 * height:
        raise DatasetError(
            f"{origin}: the principal point ({cx:.1f}, {cy:.1f}) is far from the middle of the {width}x{height} "
            "images: the intrinsics are for another resolution; use the file that belongs to these images"
        )
    return Intrinsics(float(fx), float(fy), float(cx), float(cy), width, height)


def pick_scene(names: Sequence[str], scene: str | None, folder: Path) -> str:
    """`scene` if it is one of `names`, the only one if none was asked for; else an error that lists them."""
    if scene is None and len(names) == 1:
        return names[0]
    if scene in names:
        return str(scene)
    listed = ", ".join(names[:20]) + (f" and {len(names) - 20} more" if len(names) > 20 else "")
    problem = "several scenes: name one" if scene is None else f"no scene '{scene}'"
    raise DatasetError(f"{folder}: {problem}; available: {listed}" if names else f"{folder}: no scenes here")


def scan_folders(root: Path, marker: str) -> dict[str, Path]:
    """Folders of scans by name: `root` itself where it holds the file or folder `marker`, else those under it."""
    if not root.is_dir():
        raise DatasetError(f"{root}: no such folder")
    if (root / marker).exists():
        return {root.resolve().name: root}
    return {path.parent.name: path.parent for path in sorted(root.glob(f"*/{marker}"))}


def pick_folder(root: Path, marker: str, scene: str | None) -> Path:
    """The folder of `scene`, or the only one; `DatasetError` names those there are, or the `marker` of one."""
    folders = scan_folders(root, marker)
    if not folders:
        raise DatasetError(f"{root}: no scenes here; a scan's folder holds {marker}, and this one holds none")
    return folders[pick_scene(list(folders), scene, root)]


def check_pixels(width: int, height: int, origin: object) -> None:
    """Refuse images that no camera makes and that memory may not hold, before they are unpacked."""
    if not 0 < width * height <= MOST_PIXELS:
        raise DatasetError(
            f"{origin}: {width}x{height} pixels; from 1 to {MOST_PIXELS} are read: scale it down, or export it again"
        )


def image_shape(file: Path | BytesIO, origin: object) -> tuple[int, int]:
    """Height and width, as the file's head tells them; raises `DatasetError`."""
    try:
        with Image.open(file, formats=("PNG", "JPEG")) as header:
            width, height = header.size
    except Image.DecompressionBombError as error:
        raise DatasetError(
            f"{origin}: {error}; at most {MOST_PIXELS} pixels are read: scale it down, or export it again"
        ) from error
    except (OSError, ValueError, SyntaxError) as error:
        raise DatasetError(_UNREADABLE.format(origin)) from error
    check_pixels(width, height, origin)
    return height, width


def _decode(data: bytes, origin: object, flags: int) -> np.ndarray:
    image_shape(BytesIO(data), origin)
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), flags)
    except cv2.error:
        image = None
    if image is None:
        raise DatasetError(_UNREADABLE.format(origin))
    return image
