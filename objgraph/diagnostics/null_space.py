"""Directions of the unknowns that a linear graph says nothing about."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import gtsam
import numpy as np
from jaxtyping import Float
from scipy.linalg import eigh
from scipy.sparse import bmat, csc_matrix, csr_matrix, eye
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import splu

from objgraph.diagnostics.keys import Role
from objgraph.diagnostics.linear import sparse_jacobian

TOLERANCE = 1e-6
"""A direction of which all factors together say less than this share of what they say of its variables counts
as undetermined. Decoders work in single precision, so a freedom comes out as up to 1e-7 and not as zero; the
loosest direction of well-posed maps is above 1e-3, but of a long trajectory that is held at one end."""

_DENSE = 400
"""Unknowns up to which a connected part is decomposed as a dense matrix."""
_CANDIDATE = 1e-10
"""Eigenvalues of the scaled Hessian below this are looked at closely: rounding leaves 1e-15 of zero."""
_SHIFT = 1e-13
"""Makes a singular Hessian invertible; small beside `_CANDIDATE`, large beside rounding."""
_STEPS = 5
_MOVES = 1e-4
"""A factor is asked about a direction if it moves its variables by this share of those that are moved most."""
_MOST = 256
"""Directions that are looked for in one large connected part: a longer list helps nobody."""


@dataclass(frozen=True)
class ScaledJacobian:
    """A linear graph's Jacobian with unknowns in units of what the factors say of them.

    All columns of a block (a rotation, a translation, a log-scale, a code) share one scale, the largest column's
    norm, so that which axes a block is written in does not matter.
    """

    keys: tuple[int, ...]
    """Sorted; their columns follow each other."""
    start: dict[int, int]
    """First column of every key."""
    dims: dict[int, int]
    matrix: csc_matrix
    scale: Float[np.ndarray, "d"]
    """Scaled unknowns are `scale` times tangents."""

    def rows_on(self, columns: np.ndarray) -> csr_matrix:
        """The rows that are on some of `columns`, and of these only them."""
        part = self.matrix[:, columns].tocsr()
        return part[np.diff(part.indptr) > 0]

    def columns(self, keys: Iterable[int]) -> np.ndarray:
        return np.concatenate([self.start[key] + np.arange(self.dims[key]) for key in keys])


def scaled_jacobian(
    linear: gtsam.GaussianFactorGraph, dims: dict[int, int], roles: dict[int, Role]
) -> ScaledJacobian:
    """`dims` as from `tangent_dims`."""
    ends = np.cumsum([0, *dims.values()])
    start, total = dict(zip(dims, ends.tolist(), strict=False)), int(ends[-1])
    J = sparse_jacobian(linear, dims)
    owner = np.repeat(np.arange(total), np.diff(J.indptr))
    norm = np.sqrt(np.bincount(owner, np.square(J.data), minlength=total))
    block = np.concatenate([start[key] + _blocks(roles[key], dim) for key, dim in dims.items()])
    scale = np.zeros(total)
    np.maximum.at(scale, block, norm)
    scale = np.where(scale > 0, scale, 1.0)[block]
    J.data /= scale[owner]
    return ScaledJacobian(tuple(dims), start, dims, J, scale)


def null_space(
    jacobian: csc_matrix, tolerance: float = TOLERANCE, at_least: int = 0
) -> Float[np.ndarray, "d k"]:
    """Orthonormal directions along which `jacobian` has singular values below `tolerance`, and each row says no more.

    Of a long chain that is held at one end the singular values fall with the square of its length, though the rows
    near that end are as firm as any; what a row says of a freedom is rounding. With `at_least`, as many of the loosest
    ones even if they are above it.

    Small connected parts are decomposed as dense matrices, large ones by block inverse iteration; either finds a space
    that holds all candidates, in which the singular values are those of the Jacobian itself and not roots of the
    Hessian's eigenvalues.
    """
    found: list[tuple[float, np.ndarray, np.ndarray]] = []
    for rows, columns in _parts(jacobian):
        part = jacobian[:, columns][rows]
        space = _loosest_dense(part.toarray()) if len(columns) <= _DENSE else _loosest_sparse(part)
        sigma, turn = right_singular(part @ space)
        for s, vector in zip(sigma, (space @ turn.T).T, strict=True):
            told = _told(part, vector) if s < tolerance else 0.0
            found.append((max(s, told), columns, vector))
    found.sort(key=lambda item: item[0])
    count = max(sum(told < tolerance for told, _, _ in found), min(at_least, len(found)))
    basis = np.zeros((len(jacobian.indptr) - 1, count))
    for i, (_, columns, vector) in enumerate(found[:count]):
        basis[columns, i] = vector
    return basis


def _told(part: csc_matrix, vector: Float[np.ndarray, "d"]) -> float:
    """Most that a row says of a direction, beside how far the direction moves that row's variables."""
    on = csc_matrix((np.ones_like(part.data), part.indices, part.indptr), part.shape)
    moved = np.sqrt(on @ np.square(vector))
    asked = moved > _MOVES * moved.max(initial=0.0)
    return float((np.abs(part @ vector)[asked] / moved[asked]).max(initial=0.0))


def small_null_space(matrix: Float[np.ndarray, "m d"], tolerance: float) -> Float[np.ndarray, "d k"]:
    """Orthonormal null space of a dense matrix of few columns."""
    sigma, right = right_singular(matrix)
    return right[sigma < tolerance].T


def right_singular(
    matrix: Float[np.ndarray, "m d"],
) -> tuple[Float[np.ndarray, "d"], Float[np.ndarray, "d d"]]:
    """All singular values, zeros among them, and the right singular vectors as rows."""
    _, sigma, right = np.linalg.svd(np.linalg.qr(matrix, mode="r"))
    return np.concatenate([sigma, np.zeros(len(right) - len(sigma))]), right


def _blocks(role: Role, dim: int) -> np.ndarray:
    """First column of the block that each column belongs to."""
    if role in (Role.OBJECT_POSE, Role.CAMERA):
        return np.repeat([0, 3], 3)
    # the axes of a variable that nobody knows may have units of their own
    return np.arange(dim) if role is Role.OTHER else np.zeros(dim, int)


def connected(matrix: csc_matrix) -> tuple[np.ndarray, np.ndarray]:
    """Number of the connected part of every row and of every column."""
    both = bmat([[None, matrix], [matrix.T, None]], format="csr")
    _, label = connected_components(both, directed=False)
    columns = len(matrix.indptr) - 1
    return label[:-columns], label[-columns:]


def _parts(jacobian: csc_matrix) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Rows and columns of the connected parts."""
    of_row, of_column = connected(jacobian)
    rows, columns = np.argsort(of_row, kind="stable"), np.argsort(of_column, kind="stable")
    for part in np.unique(of_column):
        first, last = np.searchsorted(of_row[rows], [part, part + 1])
        begin, end = np.searchsorted(of_column[columns], [part, part + 1])
        yield rows[first:last], columns[begin:end]


def _loosest_dense(part: Float[np.ndarray, "m d"]) -> Float[np.ndarray, "d c"]:
    eigenvalues, vectors = eigh(part.T @ part)
    return vectors[:, : max(1, np.count_nonzero(eigenvalues < _CANDIDATE))]


def _loosest_sparse(part: csc_matrix) -> Float[np.ndarray, "d c"]:
    d = len(part.indptr) - 1
    H = csc_matrix(part.T @ part)
    # symmetric positive definite: the diagonal serves as pivots
    inverse = splu(H + _SHIFT * eye(d, format="csc"), "MMD_AT_PLUS_A", 0.0, options={"SymmetricMode": True})
    width = 16
    while True:
        space = np.linalg.qr(np.random.default_rng(0).normal(size=(d, width)))[0]
        for _ in range(_STEPS):
            space = np.linalg.qr(inverse.solve(space))[0]
        largest = np.linalg.norm(part @ space, ord=2) ** 2
        if largest > _CANDIDATE or width >= _MOST:
            return space
        width *= 2
