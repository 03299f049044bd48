"""Names for the directions in which a graph's variables can move freely."""

from collections.abc import Sequence
from dataclasses import dataclass

import gtsam
import numpy as np
from jaxtyping import Float
from scipy.linalg import qr
from scipy.sparse import csc_matrix

from factors.keys import readable_key
from objgraph.diagnostics.directions import common_in_words, common_motions, has_place, in_words
from objgraph.diagnostics.keys import Role
from objgraph.diagnostics.null_space import ScaledJacobian, connected, small_null_space

_MOVES = 1e-2
"""A variable takes part in a direction if it moves by this share of the one that moves most."""
MISSING = {
    Role.OBJECT_POSE: "views of the object or a pose prior",
    Role.LOG_SCALE: "a scale prior",
    Role.CODE: "a code prior",
    Role.CAMERA: "a PriorFactorPose3 on it or a fixed camera",
    Role.POINT: "more measurements of the point or a prior",
    Role.VELOCITY: "a prior on the velocity",
    Role.OTHER: "a prior",
}
_ORDER = tuple(MISSING)


@dataclass(frozen=True)
class Undetermined:
    """Variables that can move without any factor noticing."""

    keys: tuple[int, ...]
    """Those that move, the one that moves most first."""
    direction: str
    """In words, with frame and unit."""
    missing: str
    """What would determine it, in words."""
    dof: int
    """Independent directions that `direction` stands for."""

    @property
    def key(self) -> int:
        """The variable that moves most."""
        return self.keys[0]

    def __str__(self) -> str:
        who = ", ".join(readable_key(key) for key in self.keys[:4])
        if len(self.keys) > 4:
            who += f" and {len(self.keys) - 4} more"
        if len(self.keys) == 1:
            return f"{who} ({self.direction}): it needs {self.missing}"
        return f"{who}, which move together ({self.direction}): they need {self.missing}"


class Naming:
    """Splits a null space into parts that have names: single variables, common motions, and what is left."""

    def __init__(
        self, jacobian: ScaledJacobian, role: dict[int, Role], values: gtsam.Values, tolerance: float
    ) -> None:
        self.jacobian = jacobian
        self.role = role
        self.values = values
        self.tolerance = tolerance

    def all_of(self, loose: Float[np.ndarray, "d k"]) -> list[Undetermined]:
        found = []
        for name in (self._single_variables, self._common, self._couplings):
            if loose.shape[1]:
                named, loose = name(loose)
                found += named
        return found

    def _single_variables(self, loose: np.ndarray) -> tuple[list[Undetermined], np.ndarray]:
        """Variables that can move alone."""
        found = []
        for key in self.jacobian.keys:
            columns = self.jacobian.columns([key])
            if not loose.shape[1] or np.linalg.norm(loose[columns], 2) < 0.9:
                continue
            alone = small_null_space(self.jacobian.rows_on(columns).toarray(), self.tolerance)
            if alone.shape[1]:
                words = "; ".join(in_words(self.role[key], self._tangent(columns, alone)))
                found.append(Undetermined((key,), words, MISSING[self.role[key]], alone.shape[1]))
                whole = np.zeros((len(loose), alone.shape[1]))
                whole[columns] = alone
                loose = _without(loose, whole)
        return found, loose

    def _common(self, loose: np.ndarray) -> tuple[list[Undetermined], np.ndarray]:
        """Connected parts that move as one."""
        found = []
        for keys in self._connected():
            if loose.shape[1] and np.linalg.norm(loose[self.jacobian.columns(keys)]) > _MOVES:
                named, loose = self._common_motion(keys, loose)
                found += named
        return found, loose

    def _common_motion(self, keys: Sequence[int], loose: np.ndarray) -> tuple[list[Undetermined], np.ndarray]:
        motions = common_motions({key: self.role[key] for key in keys}, self.values)
        placed = [key for key in motions if has_place(self.role[key])]
        if len(placed) < 2:
            return [], loose
        columns = self.jacobian.columns(motions)
        moved = np.concatenate(list(motions.values())) * self.jacobian.scale[columns, None]
        size = np.maximum(np.linalg.norm(moved, axis=0), 1e-12)
        left, sigma, right = np.linalg.svd(moved / size, full_matrices=False)
        real = sigma > 1e-6 * sigma[0]  # fewer than seven where all places lie on a line
        left, unmix = left[:, real], (right[real] / sigma[real, None]).T / size[:, None]
        free = small_null_space(self.jacobian.rows_on(columns) @ left, self.tolerance)
        # what a variable can do alone has a name already
        own, sigma, _ = np.linalg.svd(loose[columns].T @ (left @ free), full_matrices=False)
        own = own[:, sigma > _MOVES]
        if not own.shape[1]:
            return [], loose
        words = common_in_words(unmix @ free)
        placed.sort(key=lambda key: (self.role[key] is not Role.CAMERA, key))
        named = Undetermined(tuple(placed), "; ".join(words), self._anchor(keys, words), own.shape[1])
        return [named], _without(loose, loose @ own)

    def _couplings(self, loose: np.ndarray) -> tuple[list[Undetermined], np.ndarray]:
        """Whatever else moves together, group by group."""
        found = []
        for keys, part in _groups(self.jacobian, loose):
            named, part = self._common_motion(sorted(keys), part)
            found += named
            if part.shape[1]:
                columns = self.jacobian.columns(keys[:1])
                left, sigma, _ = np.linalg.svd(part[columns], full_matrices=False)
                main = self._tangent(columns, left[:, sigma > 0.3 * sigma[0]])
                words = "; ".join(in_words(self.role[keys[0]], main))
                mostly = f"{words}, of {readable_key(keys[0])} most" if len(keys) > 1 else words
                found.append(Undetermined(tuple(keys), mostly, self._cure(keys, part), part.shape[1]))
        return found, loose[:, :0]

    def _tangent(self, columns: np.ndarray, scaled: np.ndarray) -> np.ndarray:
        return scaled / self.jacobian.scale[columns, None]

    def _connected(self) -> list[list[int]]:
        """Keys of every connected part."""
        entries = self.jacobian.matrix.tocoo()
        keys = self.jacobian.keys
        owner = np.repeat(np.arange(len(keys)), [self.jacobian.dims[key] for key in keys])
        _, label = connected(csc_matrix((np.ones(entries.nnz), (entries.row, owner[entries.col]))))
        return [[keys[i] for i in np.flatnonzero(label == part)] for part in np.unique(label)]

    def _anchor(self, keys: Sequence[int], words: Sequence[str]) -> str:
        """What would hold variables that move as one."""
        kinds = {self.role[key] for key in keys}
        camera = "a PriorFactorPose3 on one camera or a fixed camera"
        wanted = [camera if Role.CAMERA in kinds else "a pose prior on one of them"]
        if "size of everything" in words:
            wanted.append("a scale prior on one object" if Role.LOG_SCALE in kinds else "a known distance")
            wanted = wanted if len(words) > 1 else wanted[1:]
        return " and ".join(wanted)

    def _cure(self, keys: Sequence[int], part: np.ndarray) -> str:
        """The fewest variables which, once held, hold all of `part`."""
        total = part.shape[1]
        ranks = {key: np.linalg.matrix_rank(part[self.jacobian.columns([key])], tol=_MOVES) for key in keys}
        alone = [self.role[key] for key in keys if ranks[key] == total]
        if alone:
            return " or ".join(MISSING[role] for role in sorted(set(alone), key=_ORDER.index))
        held: list[int] = []
        for key in sorted(keys, key=lambda key: -ranks[key]):
            before = np.linalg.matrix_rank(part[self.jacobian.columns(held)], tol=_MOVES) if held else 0
            if before == total:
                break
            if np.linalg.matrix_rank(part[self.jacobian.columns([*held, key])], tol=_MOVES) > before:
                held.append(key)
        return " and ".join(
            MISSING[role] for role in sorted({self.role[key] for key in held}, key=_ORDER.index)
        )


def _groups(jacobian: ScaledJacobian, loose: np.ndarray) -> list[tuple[list[int], np.ndarray]]:
    """Keys that move together, the one that moves most first, and the part of `loose` that is theirs.

    In the basis in which each of a few well-chosen unknowns moves in one direction only, independent groups
    have directions of their own.
    """
    pivots = np.asarray(qr(loose.T, mode="r", pivoting=True)[-1])
    basis = loose @ np.linalg.inv(loose[pivots[: loose.shape[1]]])
    starts = [jacobian.start[key] for key in jacobian.keys]
    share = np.sqrt(np.add.reduceat(np.square(basis), starts, axis=0))
    moves = share > _MOVES * share.max(axis=0)
    of_key, of_column = connected(csc_matrix(moves))
    found = []
    for group in np.unique(of_column):
        part = np.linalg.qr(basis[:, of_column == group])[0]
        amount = np.add.reduceat(np.square(part).sum(axis=1), starts)
        keys = [jacobian.keys[i] for i in np.argsort(-amount, kind="stable") if of_key[i] == group]
        found.append((keys, part))
    return found


def _without(space: np.ndarray, part: np.ndarray) -> np.ndarray:
    """What is left of an orthonormal basis across a part of its span."""
    part = np.linalg.qr(part)[0]
    left, sigma, _ = np.linalg.svd(space - part @ (part.T @ space), full_matrices=False)
    return left[:, sigma > 0.5]
