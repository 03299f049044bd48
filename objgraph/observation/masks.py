"""Which pixels of a frame say what about an object."""

import cv2
import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import distance_transform_edt
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from objgraph.errors import ObservationError
from objgraph.geometry.voxels import voxel_indices, voxel_keys
from objgraph.observation.frames import Frame


def clean_depth(frame: Frame, where: str, max_depth: float) -> Float[np.ndarray, "h w"]:
    depth = np.where(np.isfinite(frame.depth), frame.depth, 0.0)
    valid = depth[depth > 0]
    if len(valid) and np.median(valid) > max_depth:
        raise ObservationError(
            f"{where}: the median depth is {np.median(valid):.0f} m; depths must be metres "
            "(millimetres: divide by 1000)"
        )
    return np.where(depth <= max_depth, depth, 0.0)


def check_mask(
    mask: Bool[np.ndarray, "h w"], on_object: Bool[np.ndarray, "h w"], where: str, min_pixels: int
) -> None:
    if not mask.any():
        raise ObservationError(f"{where}: the mask is empty; choose a frame that shows the object")
    if mask.mean() > 0.98:
        raise ObservationError(f"{where}: the mask covers the whole picture; is it a mask of this object?")
    if np.count_nonzero(on_object) < min_pixels:
        raise ObservationError(
            f"{where}: {np.count_nonzero(on_object)} mask pixels have depth, at least {min_pixels} are "
            "due; choose another view"
        )


def without_flying(
    depth: Float[np.ndarray, "h w"], on_object: Bool[np.ndarray, "h w"], flying: float
) -> Bool[np.ndarray, "h w"]:
    """Mask pixels whose depth agrees with that of most of their neighbours on the mask."""
    masked = np.where(on_object, depth, 0.0).astype(np.float32)
    near = np.zeros(depth.shape, np.int32)
    for dv, du in ((-1, 0), (1, 0), (0, -1), (0, 1)):
        shifted = np.roll(masked, (dv, du), axis=(0, 1))
        near += np.abs(shifted - masked) < flying
    return on_object & (near >= 2)


def not_seen_past(
    depth: Float[np.ndarray, "h w"], on_object: Bool[np.ndarray, "h w"], step: float, window: int = 5
) -> Bool[np.ndarray, "h w"]:
    """Mask pixels without another that is nearer by more than `step` metres right beside them.

    Between slats, spokes and at outlines a mask holds pixels of what is behind the object.
    """
    far = np.where(on_object, depth, depth.max()).astype(np.float32)
    nearest_beside = cv2.erode(far, np.ones((window, window), np.uint8))
    return on_object & (depth - nearest_beside <= step)


def of_one_object(
    points: Float[np.ndarray, "n 3"], gap: float, cell: float = 0.05, share: float = 0.2
) -> Bool[np.ndarray, "n"]:
    """True for points of the large connected parts, and of small ones within `gap` of those.

    What a mask spills onto a far wall must not widen the object.
    """
    if len(points) == 0:
        return np.zeros(0, dtype=bool)
    keys, inverse = np.unique(voxel_keys(points, cell), return_inverse=True)
    cells = voxel_indices(keys)
    # in cells: metres of equal distances differ by rounding, and with them what hangs together
    pairs = cKDTree(cells).query_pairs(2.0, output_type="ndarray")
    links = coo_matrix((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(cells),) * 2)
    _, part = connected_components(links, directed=False)
    size = np.bincount(part[inverse], minlength=part.max() + 1)
    large = (size >= min(share * len(points), size.max()))[part]
    near = cKDTree(cells[large]).query(cells)[0] <= gap / cell + 1e-6
    whole = np.bincount(part, weights=near, minlength=len(size)) > 0.5 * np.bincount(
        part, minlength=len(size)
    )
    return (large | whole[part])[inverse]


def free_weights(mask: Bool[np.ndarray, "h w"], margin: float) -> Float[np.ndarray, "h w"]:
    """How densely free rays are drawn: outlines say most, but a shape must not grow unseen far beside the mask."""
    away = distance_transform_edt(~mask)
    near = margin * np.sqrt(np.count_nonzero(mask))
    return np.where(mask, 0.0, 1.0 / (1.0 + np.square(away / near)))  # pyright: ignore[reportOperatorIssue]


def nearest(depth: Float[np.ndarray, "h w"], known: Bool[np.ndarray, "h w"]) -> Float[np.ndarray, "h w"]:
    """Depth of the nearest pixel that is `known`; infinite where none is.

    Across an outline this is what would be seen but for the object, or where the object next to a pixel lies.
    """
    if not known.any():
        return np.full(depth.shape, np.inf)
    _, (v, u) = distance_transform_edt(~known, return_indices=True)  # pyright: ignore[reportGeneralTypeIssues]
    return depth[v, u]
