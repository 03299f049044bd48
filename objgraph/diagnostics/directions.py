"""Tangent directions of variables in words, and the motions of everything that no relative measurement sees."""

from collections.abc import Iterable

import gtsam
import numpy as np
from jaxtyping import Float

from objgraph.diagnostics.keys import Role
from objgraph.diagnostics.null_space import right_singular

_PURE = 1e-2
"""A part of a unit direction smaller than this is not worth a word."""
_FRAMES = {Role.OBJECT_POSE: "object frame", Role.CAMERA: "camera frame"}


def in_words(role: Role, basis: Float[np.ndarray, "d k"]) -> list[str]:
    """What a variable's tangent moves along in the columns of `basis`, which are independent."""
    if role in _FRAMES:
        return rigid_motion(basis, _FRAMES[role])
    basis = np.linalg.qr(basis)[0]
    if role is Role.LOG_SCALE:
        return [_log_scale(basis)]
    if role is Role.CODE:
        return [_code(basis)]
    if role is Role.POINT:
        return rigid_motion(np.concatenate([np.zeros_like(basis), basis]), "world frame")
    if role is Role.VELOCITY:
        return [f"velocity {_span(basis, 'along')} of the world frame, m/s"]
    return [f"tangent {_listed([str(i) for i in _strongest(basis)])} of {len(basis)}"]


def rigid_motion(basis: Float[np.ndarray, "6 k"], frame: str) -> list[str]:
    """Translations, rotations and what is left of both, of tangents [rotation, translation]."""
    basis = np.linalg.qr(basis)[0]
    shifts, rest = _vanishing(basis, basis[:3])
    turns, rest = _vanishing(rest, rest[3:])
    words = []
    if shifts.shape[1]:
        words.append(f"translation {_span(shifts[3:], 'along')} of the {frame}, m")
    if turns.shape[1]:
        words.append(f"rotation {_span(turns[:3], 'about')} of the {frame}, rad")
    for mixed in rest.T:
        words.append(
            f"rotation about {_axis(mixed[:3])} together with translation along {_axis(mixed[3:])} "
            f"of the {frame}"
        )
    return words


def common_motions(roles: dict[int, Role], values: gtsam.Values) -> dict[int, Float[np.ndarray, "d 7"]]:
    """Every variable's tangent as all of them turn (3), move (3) and grow (1) about their middle.

    Axes are the world's. Codes do not move; variables of no known role are taken not to.
    """
    places = [_place(key, role, values) for key, role in roles.items() if has_place(role)]
    centre = np.mean(places, axis=0) if places else np.zeros(3)
    motions = {}
    for key, role in roles.items():
        if has_place(role):
            arm = _place(key, role, values) - centre
            moved = np.hstack([_cross(arm), np.eye(3), arm[:, None]])
            if role is Role.POINT:
                motions[key] = moved
                continue
            R_object_world = values.atPose3(key).rotation().matrix().T
            turned = np.hstack([np.eye(3), np.zeros((3, 4))])
            motions[key] = np.vstack([R_object_world @ turned, R_object_world @ moved])
        elif role is Role.VELOCITY:
            velocity = values.atPoint3(key)
            motions[key] = np.hstack([_cross(velocity), np.zeros((3, 3)), velocity[:, None]])
        elif role is Role.LOG_SCALE:
            motions[key] = np.hstack([np.zeros((3, 6)), np.ones((3, 1))])
    return motions


def common_in_words(mix: Float[np.ndarray, "7 k"]) -> list[str]:
    """The columns of `mix`, which combine the motions of `common_motions`, in words."""
    mix = np.linalg.qr(mix)[0]
    rigid, growing = _vanishing(mix, mix[6:])
    words = rigid_motion(rigid[:6], "world frame") if rigid.shape[1] else []
    return [*words, "size of everything"] if growing.shape[1] else words


def has_place(role: Role) -> bool:
    """Whether such a variable stands somewhere in the world."""
    return role in (Role.OBJECT_POSE, Role.CAMERA, Role.POINT)


def _place(key: int, role: Role, values: gtsam.Values) -> np.ndarray:
    return values.atPoint3(key) if role is Role.POINT else np.array(values.atPose3(key).translation())


def _cross(arm: np.ndarray) -> np.ndarray:
    """How a place at `arm` moves with small turns: [arm]x transposed."""
    x, y, z = arm
    return np.array([[0, z, -y], [-z, 0, x], [y, -x, 0]])


def _vanishing(basis: np.ndarray, part: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The directions of `basis` in which `part`, some of its rows, is zero, and those orthogonal to them."""
    if not basis.shape[1]:
        return basis, basis
    sigma, turn = right_singular(part)
    zero = sigma < _PURE
    return basis @ turn[zero].T, basis @ turn[~zero].T


def _span(vectors: np.ndarray, preposition: str) -> str:
    left, sigma, _ = np.linalg.svd(vectors)
    rank = np.count_nonzero(sigma > _PURE)
    if rank == 1:
        return f"{preposition} {_axis(left[:, 0])}"
    every = "in every direction" if preposition == "along" else "about every axis"
    return every if rank == 3 else f"{every} across {_axis(left[:, 2])}"


def _axis(vector: np.ndarray) -> str:
    unit = vector / np.linalg.norm(vector)
    unit = unit * np.sign(unit[np.argmax(np.abs(unit))])
    for name, value in zip("xyz", unit, strict=True):
        if value > 1 - 1e-4:
            return name
    return f"({', '.join(f'{value:.2f}' for value in unit + 0.0)})"


def _log_scale(basis: np.ndarray) -> str:
    if basis.shape[1] == 3:
        return "log-scale of every axis"
    if basis.shape[1] == 1 and abs(basis.sum()) > 1.7:  # the root of three
        return "the common log-scale of all axes"
    return " and ".join(f"log_scale_{'xyz'[i]}" for i in _strongest(basis))


def _code(basis: np.ndarray) -> str:
    d, k = basis.shape
    if k == d:
        return "the whole code"
    mostly = _listed([f"code_{i}" for i in _strongest(basis)])
    return f"code direction, mostly {mostly}" if k == 1 else f"{k} directions of the code, mostly {mostly}"


def _strongest(basis: np.ndarray, most: int = 4) -> list[int]:
    """Coordinates that an orthonormal basis moves most, as many as hold most of it."""
    weight = np.square(basis).sum(axis=1)
    order = np.argsort(-weight, kind="stable")
    count = int(np.searchsorted(np.cumsum(weight[order]), 0.8 * basis.shape[1])) + 1
    return [int(i) for i in order[: min(count, max(most, basis.shape[1]))]]


def _listed(names: Iterable[str]) -> str:
    return ", ".join(names)
