"""One object of a map: pose, scale, shape code, covariance and mesh, checked on the way in."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import gtsam
import numpy as np
from jaxtyping import Float, Int

from factors import checks
from factors.state import RIGID_DOF, ObjectState
from objgraph.covariance.box import BOX_AXES, BoxPose
from objgraph.covariance.box_modes import BoxMode, box_modes
from objgraph.covariance.heading_modes import HeadingModes
from objgraph.covariance.labelled import RIGID_AXES, LabelledCovariance, ObjectCovariance
from objgraph.errors import CovarianceError, MapError
from objgraph.geometry.frames import is_rigid
from objgraph.maps.other_estimate import ESTIMATE_SHAPES, OtherEstimate, read_only
from objgraph.trust.verdict import Trust

COVARIANCE_AXES = RIGID_AXES
"""The 9 axes of `MappedObject.covariance`: GTSAM's Pose3 tangent in the body frame, then the log-scale."""

BOX_COVARIANCE_AXES = BOX_AXES
"""The 9 axes of `MappedObject.box_covariance`: Pose3's tangent of the box, then the logarithms of its extents."""

_SHAPES: dict[str, tuple[int | None, ...]] = {
    **ESTIMATE_SHAPES,
    "cameras": (None, 4, 4),
    "size_m": (3,),
    "box_centre": (3,),
    "box_extents": (3,),
    "box_covariance": (9, 9),
    "turns": (4,),
    "turned": (4, None),
    "vertices": (None, 3),
    "faces": (None, 3),
    "vertex_sigma": (None,),
    "joint_covariance": (None, None),
}
_NUMBERS = ("cost_initial", "cost_final", "seconds")
_COUNTS = ("linearizations", "error_evaluations")
_IDS = checks.Range(-(2**63), 2**64 - 1)
"""What a document can hold."""


@dataclass(frozen=True)
class PriorReference:
    """Which shape prior an object's code belongs to."""

    name: str
    hash: str
    """Of the weights, so that a code is never decoded by another decoder unnoticed."""
    fallback: bool = False
    """Whether it only stands in, because the category has no prior of its own."""


@dataclass(frozen=True, eq=False)
class MappedObject:
    """One object of the map; arrays are read-only float64 (faces int64).

    Raises:
        MapError: a field has another shape, is not finite, or contradicts another; it names object and field.
    """

    id: int
    """Instance id, as in `Frame.instances`."""
    category: str
    status: Literal["mapped", "failed"]
    """A mapped object has at least a pose, a scale and a code; a failed one has None for what is missing."""
    reason: str | None = None
    """Why it failed."""
    T_world_object: Float[np.ndarray, "4 4"] | None = None
    """Rigid: p_world = T_world_object (scale * p_object)."""
    scale: Float[np.ndarray, "3"] | None = None
    """Metres per canonical unit along the object's own axes."""
    code: Float[np.ndarray, "l"] | None = None
    """Shape code."""
    covariance: Float[np.ndarray, "9 9"] | None = None
    """Of pose and log-scale, as the estimator gives it: the graph's marginals are too small (docs/guides/covariances.md).
    `COVARIANCE_AXES` says what each row is."""
    code_sigma: Float[np.ndarray, "l"] | None = None
    """Standard deviation of each entry of the code."""
    estimator: str | None = None
    """Whose pose, scale, code and covariance these are: "graph" or "adam"."""
    other: OtherEstimate | None = None
    """The other estimator's, where both were run."""
    cost_initial: float | None = None
    """Of the first guess, in the estimator's objective."""
    cost_final: float | None = None
    linearizations: int | None = None
    error_evaluations: int | None = None
    seconds: float | None = None
    """Wall time spent on this object."""
    seconds_by_stage: Mapping[str, float] = field(default_factory=dict)
    """Parts of `seconds`, by stage."""
    views: tuple[str, ...] = ()
    """Names of the frames it was seen in and mapped from."""
    cameras: Float[np.ndarray, "n 4 4"] | None = None
    """T_world_camera of these frames."""
    size_m: Float[np.ndarray, "3"] | None = None
    """Extents along the object's own axes: width (x), height (y), depth (z), metres."""
    box_centre: Float[np.ndarray, "3"] | None = None
    """Of its box along its own axes, world frame; of the box it has a covariance that was calibrated, or nothing."""
    box_extents: Float[np.ndarray, "3"] | None = None
    """Edges of that box, metres."""
    box_covariance: Float[np.ndarray, "9 9"] | None = None
    """Of that box, calibrated: 95 % sets hold as many (`trust`); with the second moment of the other headings it may have. None
    where no calibration was measured for the prior or the estimator. `BOX_COVARIANCE_AXES` says what each row is."""
    trust: Trust | None = None
    """How likely pose and shape are right, and why not; None where there is no box covariance."""
    turns: Float[np.ndarray, "4"] | None = None
    """Probabilities that it stands like this, or within the same box turned by a quarter, a half and three quarters about
    its up axis; None where no other heading comes near. The covariance is of this heading alone."""
    turned: Float[np.ndarray, "4 9+l"] | None = None
    """What leads from its state to the likeliest at each of these turns (`ObjectState.retract`); zeros where one has no
    chance."""
    prior: PriorReference | None = None
    vertices: Float[np.ndarray, "v 3"] | None = None
    """Of the surface, world frame, metres."""
    faces: Int[np.ndarray, "f 3"] | None = None
    """Counter-clockwise seen from outside."""
    vertex_sigma: Float[np.ndarray, "v"] | None = None
    """Standard deviation of the surface at each vertex, metres, with the prior's `surface_misfit`."""
    joint_covariance: Float[np.ndarray, "9+l 9+l"] | None = None
    """Of pose, log-scale and code together; `covariance` and `code_sigma` are parts of it."""

    def __post_init__(self) -> None:
        label = _label(self)
        for name in ("category", "status", "reason", "estimator"):
            value = getattr(self, name)
            if not isinstance(value, str) and (value is not None or name in ("category", "status")):
                raise _bad(self, name, f"is no text ({value!r})")
        if self.reason is not None:  # it may quote a name of any bytes
            self._put("reason", self.reason.encode(errors="replace").decode())
        self._put("id", checks.whole(f"{label}: id", self.id, _IDS, MapError))
        given = {name: value for name, value in vars(self).items() if value is not None}
        for name in _SHAPES.keys() & given.keys():
            dtype = np.int64 if name == "faces" else np.float64
            self._put(name, read_only(f"{label}: {name}", given[name], _SHAPES[name], dtype))
        for name in given.keys() & set(_NUMBERS):
            self._put(name, checks.number(f"{label}: {name}", given[name], error=MapError))
        for name in given.keys() & set(_COUNTS):
            self._put(name, checks.whole(f"{label}: {name}", given[name], error=MapError))
        if self.trust is not None and not isinstance(self.trust, Trust):
            raise _bad(self, "trust", f"is no Trust ({type(self.trust).__name__})")
        if not isinstance(self.views, (list, tuple)) or not isinstance(self.seconds_by_stage, Mapping):
            raise _bad(self, "views", "must be a list, and seconds_by_stage a dictionary")
        self._put("views", tuple(str(view) for view in self.views))
        names = [("category", self.category), ("estimator", self.estimator or "")]
        for name, value in [*names, *(("view", view) for view in self.views)]:
            checks.string(f"object {self.id}: {name}", value, MapError)
        if not self.views and self.cameras is not None and not self.cameras.size:
            self._put("cameras", None)  # JSON does not tell no cameras from none given
        where, stages = f"{label}: seconds_by_stage", self.seconds_by_stage.items()
        seconds = {str(k): checks.number(f"{where}.{k}", v, error=MapError) for k, v in stages}
        self._put("seconds_by_stage", seconds)
        _check_consistency(self)

    @property
    def name(self) -> str:
        """As pages, tables and messages call it."""
        return f"{self.category} {self.id}"

    @property
    def is_fallback(self) -> bool:
        """Whether its category had no prior, and another stood in."""
        return self.prior is not None and self.prior.fallback

    @property
    def state(self) -> ObjectState:
        """Pose, scale and code; raises MapError of an object that is not mapped."""
        if self.T_world_object is None or self.scale is None or self.code is None:
            raise MapError(f"{_label(self)} is not mapped: {self.reason}")
        return ObjectState(gtsam.Pose3(self.T_world_object), np.log(self.scale), np.array(self.code))

    @property
    def other_headings(self) -> HeadingModes | None:
        """`turns` and `turned`, for `box_pose` and active vision's `target`."""
        if self.turns is None:
            return None
        if self.turned is None:
            return HeadingModes(self.turns)
        state = self.state
        states = [
            state.retract(row) if p > 0 else None for row, p in zip(self.turned, self.turns, strict=True)
        ]
        return HeadingModes(self.turns, tuple(states))

    @property
    def box_modes(self) -> tuple[BoxMode, ...]:
        """The calibrated box at each heading that it may have; empty where it has none."""
        if self.box_centre is None or self.box_extents is None or self.box_covariance is None:
            return ()
        turns, matrix = self.other_headings, self.box_covariance
        if turns is not None:
            matrix = matrix - turns.second_moment(self.box_extents)
        state = self.state
        T_world_box = gtsam.Pose3(state.T_world_object.rotation(), self.box_centre)
        known = LabelledCovariance(matrix, BOX_AXES, "calibrated", _label(self))
        return box_modes(BoxPose(T_world_box, self.box_extents, known), state, turns)

    @property
    def uncertainty(self) -> ObjectCovariance:
        """The joint covariance; raises MapError where the map has none."""
        if self.joint_covariance is None:
            raise MapError(f"{_label(self)} has no joint covariance; map it again")
        source = "adam" if self.estimator == "adam" else "marginals"
        return ObjectCovariance.of(self.joint_covariance, source, self.name)

    def _put(self, name: str, value: Any) -> None:
        object.__setattr__(self, name, value)


def _check_consistency(entry: MappedObject) -> None:
    if entry.status not in ("mapped", "failed"):
        raise _bad(entry, "status", f"is {entry.status!r}, neither 'mapped' nor 'failed'")
    if entry.status == "failed" and not entry.reason:
        raise _bad(entry, "reason", "must say why the object failed")
    for name in ("T_world_object", "scale", "code"):
        if entry.status == "mapped" and getattr(entry, name) is None:
            raise _bad(entry, name, "is missing although the object is mapped")
    if entry.T_world_object is not None and not is_rigid(entry.T_world_object):
        raise _bad(entry, "T_world_object", "is no rigid transform; the scale has a field of its own")
    if entry.scale is not None and not (entry.scale > 0).all():
        raise _bad(entry, "scale", "must be positive")
    if entry.covariance is not None and (np.diagonal(entry.covariance) < 0).any():
        raise _bad(entry, "covariance", "has a negative variance")
    box = (entry.box_centre, entry.box_extents, entry.box_covariance)
    if any(part is None for part in box) and any(part is not None for part in box):
        raise _bad(entry, "box_covariance", "needs box_centre and box_extents, and they it")
    if entry.box_extents is not None and not (entry.box_extents > 0).all():
        raise _bad(entry, "box_extents", "must be positive")
    for name, sigma in (("code_sigma", entry.code_sigma), ("vertex_sigma", entry.vertex_sigma)):
        if sigma is not None and (sigma < 0).any():
            raise _bad(entry, name, "has a negative entry")
    if entry.box_covariance is not None and (np.diagonal(entry.box_covariance) < 0).any():
        raise _bad(entry, "box_covariance", "has a negative variance")
    if entry.code is not None and entry.code_sigma is not None and len(entry.code) != len(entry.code_sigma):
        raise _bad(entry, "code_sigma", f"has {len(entry.code_sigma)} entries, the code {len(entry.code)}")
    if entry.cameras is not None and len(entry.cameras) != len(entry.views):
        raise _bad(entry, "cameras", f"are {len(entry.cameras)}, for {len(entry.views)} views")
    if entry.cameras is not None and not all(is_rigid(T) for T in entry.cameras):
        raise _bad(entry, "cameras", "are no rigid transforms")
    if entry.turned is not None:
        length = None if entry.code is None else RIGID_DOF + len(entry.code)
        if entry.turns is None:
            raise _bad(entry, "turned", "is given without turns")
        if entry.turned.shape[1] != length:
            raise _bad(entry, "turned", f"has shape {entry.turned.shape}, not 4 x {length}")
    try:
        _ = entry.other_headings
    except CovarianceError as error:
        raise _bad(entry, "turns", f"are none: {error}") from error
    _check_joint(entry)
    _check_surface(entry)


def _check_joint(entry: MappedObject) -> None:
    joint = entry.joint_covariance
    if joint is None:
        return
    length = None if entry.code is None else RIGID_DOF + len(entry.code)
    if joint.shape != (length, length):
        raise _bad(entry, "joint_covariance", f"has shape {joint.shape}, not {length} x {length}")
    try:
        ObjectCovariance.of(joint, "")
    except CovarianceError as error:
        raise _bad(entry, "joint_covariance", f"is none: {error}") from error
    parts = [(entry.covariance, joint[:RIGID_DOF, :RIGID_DOF])]
    parts.append((entry.code_sigma, np.sqrt(np.diag(joint)[RIGID_DOF:])))
    if any(part is not None and not np.allclose(part, of, rtol=1e-6, atol=1e-12) for part, of in parts):
        raise _bad(entry, "joint_covariance", "contradicts covariance or code_sigma")


def _check_surface(entry: MappedObject) -> None:
    if (entry.vertices is None) != (entry.faces is None):
        raise _bad(entry, "faces" if entry.faces is None else "vertices", "is missing: a mesh has both")
    if entry.vertices is None or entry.faces is None:
        if entry.vertex_sigma is not None:
            raise _bad(entry, "vertex_sigma", "is given without vertices")
        return
    if not len(entry.faces) or entry.faces.min() < 0 or entry.faces.max() >= len(entry.vertices):
        raise _bad(entry, "faces", f"is empty or names vertices outside 0..{len(entry.vertices) - 1}")
    if entry.vertex_sigma is not None and len(entry.vertex_sigma) != len(entry.vertices):
        raise _bad(entry, "vertex_sigma", f"has {len(entry.vertex_sigma)} entries, not {len(entry.vertices)}")


def _bad(entry: MappedObject, name: str, problem: str) -> MapError:
    return MapError(f"{_label(entry)}: {name} {problem}")


def _label(entry: MappedObject) -> str:
    return f"object {entry.id} ({entry.category})"
