"""A shape code becomes a triangle mesh: the decoder's zero level by marching cubes."""

import itertools
import logging
from collections.abc import Callable

import numpy as np
import torch
import trimesh
from jaxtyping import Bool, Float, Int

from factors import checks
from factors.sdf_decoder import SdfDecoder
from objgraph.errors import SolveError
from objgraph.geometry.frames import transformed

_LOG = logging.getLogger(__name__)
_BLOCKS = (8, 4, 2)
"""Sides, in cells, of the blocks whose centres decide where to look closer."""

RESOLUTIONS = checks.Range(1, 1024)
"""Cells along an edge of a grid."""
RESOLUTION = 96
"""Of a mesh: with two thirds as many legs of a table come out in pieces, which are left out."""

Field = Callable[[Float[np.ndarray, "n 3"]], Float[np.ndarray, "n"]]


def extract_mesh(
    decoder: SdfDecoder,
    code: Float[np.ndarray, "l"],
    resolution: int = RESOLUTION,
    bound: float = 0.55,
    *,
    remove_floaters: bool = True,
    floater_share: float = 0.02,
    slope: float = 2.0,
    chunk: int = 32768,
) -> trimesh.Trimesh:
    """Mesh of the decoder's zero level in the canonical frame, closed, triangles facing outwards.

    The grid spans [-bound, bound]^3 with `resolution` cells an axis (rounded up to a multiple of 8). A block
    whose centre is farther from the surface than `slope` allows over its half diagonal is not looked into;
    `slope` bounds the decoder's gradient. Where a sign change shows the bound to be wrong, the surface is
    followed cell by cell. What would leave the grid is cut off at its border. With `remove_floaters`,
    connected parts below `floater_share` of the whole area are left out, but for the largest.

    Raises:
        SolveError: the code is not one of this decoder's, or the surface does not pass through the grid.
    """
    grid = sdf_grid(decoder, code, resolution, bound, slope=slope, chunk=chunk)
    return mesh_of_grid(grid, bound, remove_floaters=remove_floaters, floater_share=floater_share)


def sdf_grid(
    decoder: SdfDecoder,
    code: Float[np.ndarray, "l"],
    resolution: int = RESOLUTION,
    bound: float = 0.55,
    *,
    slope: float = 2.0,
    chunk: int = 32768,
) -> Float[np.ndarray, "g g g"]:
    """SDF at the nodes of `extract_mesh`'s grid, by axes x, y, z: exact near the surface, elsewhere of its sign.

    Raises:
        SolveError: the code is not one of this decoder's.
    """
    checks.whole("the resolution of a mesh", resolution, RESOLUTIONS, SolveError)
    return field_grid(_field(decoder, code, chunk), resolution, bound, slope=slope)


def field_grid(
    field: Field, resolution: int = RESOLUTION, bound: float = 0.55, *, slope: float = 1.0
) -> Float[np.ndarray, "g g g"]:
    """The same of any signed distance; `slope` bounds its gradient."""
    cells = _BLOCKS[0] * -(-int(resolution) // _BLOCKS[0])
    return _narrow_band(field, cells, bound, slope)


def mesh_of_grid(
    grid: Float[np.ndarray, "g g g"],
    bound: float = 0.55,
    *,
    remove_floaters: bool = True,
    floater_share: float = 0.02,
) -> trimesh.Trimesh:
    """The zero level of an SDF at the nodes of a grid over [-bound, bound]^3, as `extract_mesh` says.

    Raises:
        SolveError: a value is not finite, or the surface does not pass through the grid.
    """
    if not np.isfinite(grid).all():
        raise SolveError("the decoder's SDF is not finite on the grid: the shape code has diverged")
    # what is inside at the border alone is cut off whole
    low, high = float(np.min(grid[1:-1, 1:-1, 1:-1])), float(np.max(grid))
    if low >= 0 or high <= 0:
        meaning = "everything is outside" if low >= 0 else "everything is inside"
        raise SolveError(
            f"no surface: the SDF on the grid of [-{bound}, {bound}]^3 lies in {low:.4g} .. {high:.4g}, "
            f"so {meaning} the shape; the code is far from those the decoder was trained on (strengthen the "
            f"code's prior), or the wrong decoder was given"
        )
    mesh = _marching_cubes(_closed_at_border(grid), bound)
    return _without_floaters(mesh, floater_share) if remove_floaters else mesh


def to_world(
    mesh: trimesh.Trimesh, T_world_object: Float[np.ndarray, "4 4"], scale: Float[np.ndarray, "3"]
) -> trimesh.Trimesh:
    """The canonical mesh in the world, in metres: p_world = T_world_object (scale * p_object).

    Raises:
        SolveError: the transform or the scale has another shape, or a scale is not positive.
    """
    T, scale = np.asarray(T_world_object, float), np.asarray(scale, float)
    if T.shape != (4, 4) or scale.shape != (3,) or not (scale > 0).all():
        raise SolveError(
            f"a mesh is placed by a 4x4 matrix and 3 positive scales, not by {T.shape} and {scale.tolist()}"
        )
    vertices = transformed(T, np.asarray(mesh.vertices) * scale)
    return trimesh.Trimesh(vertices, np.asarray(mesh.faces), process=False)


def _field(decoder: SdfDecoder, code: Float[np.ndarray, "l"], chunk: int) -> Field:
    parameter = next(decoder.parameters(), torch.empty(0))
    codes = torch.as_tensor(np.array(code), dtype=parameter.dtype, device=parameter.device)[None]
    if codes.shape != (1, decoder.code_length):
        raise SolveError(
            f"a code of shape {np.shape(code)} does not fit this decoder: it takes ({decoder.code_length},)"
        )

    def field(points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n"]:
        p = torch.as_tensor(points, dtype=parameter.dtype, device=parameter.device)
        with torch.no_grad():
            values = [decoder(part, codes) for part in p.split(chunk)]
        return torch.cat(values).double().cpu().numpy()

    return field


def _narrow_band(field: Field, cells: int, bound: float, slope: float) -> Float[np.ndarray, "g g g"]:
    """SDF at the grid's nodes: exact near the surface, elsewhere that of some block's centre."""
    h = 2 * bound / cells
    grid = np.full((cells + 1,) * 3, np.nan)
    side = _BLOCKS[0]
    corners = _lattice(0, cells, side)
    for side in _BLOCKS:
        values = field((corners + side / 2) * h - bound)
        near = np.abs(values) <= slope * np.sqrt(3) / 2 * side * h
        nodes = corners[~near, None] + _lattice(0, side + 1, 1)
        grid[tuple(np.moveaxis(nodes, -1, 0))] = values[~near, None]
        corners = corners[near]
        if side != _BLOCKS[-1]:
            corners = (corners[:, None] + _lattice(0, side, side // 2)).reshape(-1, 3)
    wanted = np.zeros(grid.shape, bool)
    nodes = corners[:, None] + _lattice(0, side + 1, 1)
    wanted[tuple(np.moveaxis(nodes, -1, 0))] = True
    known = np.zeros(grid.shape, bool)
    while (missing := wanted & ~known).any():
        grid[missing] = field(np.argwhere(missing) * h - bound)
        known |= missing
        wanted = _nodes_of_crossed_cells(grid)
    return grid


def _lattice(start: int, stop: int, step: int) -> Int[np.ndarray, "n 3"]:
    axis = np.arange(start, stop, step)
    return np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)


def _nodes_of_crossed_cells(grid: Float[np.ndarray, "g g g"]) -> Bool[np.ndarray, "g g g"]:
    """The corners of every cell through which the surface passes."""
    inside = grid < 0
    n = len(grid) - 1
    corners = [tuple(slice(d, d + n) for d in offset) for offset in itertools.product((0, 1), repeat=3)]
    some, every = np.zeros((n,) * 3, bool), np.ones((n,) * 3, bool)
    for corner in corners:
        some |= inside[corner]
        every &= inside[corner]
    nodes = np.zeros(grid.shape, bool)
    for corner in corners:
        nodes[corner] |= some & ~every
    return nodes


def _closed_at_border(grid: Float[np.ndarray, "g g g"]) -> Float[np.ndarray, "g g g"]:
    """The grid with an outermost layer that is outside, so that no surface is open."""
    closed = np.full(grid.shape, 1e-6)
    inner = (slice(1, -1),) * 3
    if (grid < 0).sum() > (grid[inner] < 0).sum():
        _LOG.warning("a mesh was cut off at the box that holds any shape learnt: its code is of none of them")
    closed[inner] = grid[inner]
    return np.where(grid > 0, grid, closed)


def _marching_cubes(grid: Float[np.ndarray, "g g g"], bound: float) -> trimesh.Trimesh:
    h = 2 * bound / (len(grid) - 1)
    from skimage import measure  # slow to import, and of use only here

    vertices, faces, _, _ = measure.marching_cubes(grid, 0.0, spacing=(h, h, h), gradient_direction="descent")
    return trimesh.Trimesh(vertices.astype(float) - bound, faces, process=True)


def _without_floaters(mesh: trimesh.Trimesh, share: float) -> trimesh.Trimesh:
    labels = trimesh.graph.connected_component_labels(mesh.face_adjacency, node_count=len(mesh.faces))
    area = np.bincount(labels, weights=mesh.area_faces)
    # of many small parts the largest stays
    keep = area[labels] >= min(share * area.sum(), area.max())
    if keep.all():
        return mesh
    kept = mesh.copy()
    kept.update_faces(keep)
    kept.remove_unreferenced_vertices()
    return kept
