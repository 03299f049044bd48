"""What association is given and what it answers."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from factors import checks
from factors.checks import DEVIATIONS
from factors.sdf_decoder import SdfDecoder
from factors.state import CAMERA_DOF, RIGID_DOF, ObjectState
from objgraph.errors import ConfigError, FactorError, SolveError
from objgraph.observation.sampling import ObjectView


@dataclass(frozen=True)
class AssociationConfig:
    """When a detection is a mapped object, and when two mapped objects are one."""

    reach: float = 1.0
    """A detection farther than this (metres) outside an object's bounding sphere is not compared with it; more than
    a camera may have drifted since the object was last seen."""
    candidates: int = 4
    """Objects at most, the nearest, that a detection is compared with."""
    points: int = 80
    """Surface points of a detection that are compared, a random part of its own."""
    rays: int = 80
    """Rays of a detection that are compared, a random part of its own."""
    steps: int = 6
    """Decoder calls at most in which detections are moved onto objects' surfaces; one more is for free space."""
    observable: float = 0.03
    """Mean square of the surface normals' component along a direction from which on the points say where along it
    they lie (0.03: normals that lean by ten degrees)."""
    probability: float = 0.999
    """Share of true matches that the Mahalanobis gate lets through."""
    unmodelled: float = 0.02
    """Metres, standard deviation, that the offset of a whole view may have beside what the covariances and the
    noise say: the decoder's misfit is shared by all points of a view."""
    distance: float = 0.06
    """A point this near (metres) to a surface lies on it."""
    overlap: float = 0.5
    """Share of a detection's points that must lie on the object's surface once moved by their offset."""
    inside: float = 0.02
    """A ray that comes deeper (metres) under a surface passes through it."""
    contradicted: float = 0.4
    """Share of the rays beside the detection that may pass through the object."""
    spacing: float = 4.0
    """Edge (metres) of the cube in which one object is expected that is not in the map yet: sets what it costs to
    start a new one, so that an object whose place is hardly known does not take in whatever is seen."""
    overlap_cost: float = 10.0
    """Cost of a detection none of whose points lies on the object, in units of squared Mahalanobis distance."""
    start_points: int = 10
    """A detection of fewer points cannot start an object."""
    merge_iou: float = 0.3
    """Intersection over union that the boxes of two mapped objects have where they must be one: two solid things
    cannot stand in the same place."""
    merge_overlap: float = 0.6
    """Share of each one's surface that lies on the other's where they are one."""
    merge_points: int = 200
    """Points on each surface that tell it."""

    def __post_init__(self) -> None:
        """Raises ConfigError where a number is not one of its kind."""
        some, share = checks.Range(1, 10**6), checks.Range(0, 1)
        checks.settings(
            self, ConfigError, candidates=some, points=some, rays=some, steps=checks.Range(1, 1000),
            observable=checks.Range(1e-6, 1), probability=checks.Range(1e-6, 1 - 1e-12),
            distance=checks.POSITIVE, overlap=share, contradicted=share, spacing=DEVIATIONS, start_points=some,
            merge_iou=share, merge_overlap=share, merge_points=some,
        )  # fmt: skip


@dataclass(frozen=True)
class Detection:
    """What one frame shows of one object."""

    view: ObjectView
    category: str


@dataclass(frozen=True)
class MappedCandidate:
    """A mapped object that detections may be of."""

    name: str
    """For messages."""
    category: str
    decoder: SdfDecoder
    state: ObjectState
    covariance: Callable[[], Float[np.ndarray, "d d"]]
    """Joint covariance of [pose 6, log-scale 3, code l] or, with the camera's 6 after them, of object and camera
    with their cross blocks; poses in the body frame. Asked for where it is needed alone, at most once a call."""
    residual_sigma: float = 0.0
    """Standard deviation of the decoder's own error, canonical units (`ShapePrior.residual_sigma`)."""

    @property
    def radius(self) -> float:
        """Metres about its centre that hold it: canonical boxes have a diagonal of 1."""
        return 0.5 * float(np.max(self.state.scale))

    @property
    def is_finite(self) -> bool:
        state = self.state
        return bool(
            np.isfinite(state.T_world_object.matrix()).all()
            and np.isfinite(state.scale).all()
            and np.isfinite(state.code).all()
        )

    def checked_covariance(self) -> Float[np.ndarray, "d d"]:
        """The joint covariance.

        Raises:
            FactorError: it has another shape, or the code is not one of the decoder's.
            SolveError: it is not finite.
        """
        length = self.decoder.code_length
        if len(self.state.code) != length:
            raise FactorError(
                f"{self.name}: a code of length {len(self.state.code)}, but the decoder takes {length}"
            )
        matrix = np.asarray(self.covariance(), dtype=float)
        alone = RIGID_DOF + length
        if matrix.shape not in ((alone, alone), (alone + CAMERA_DOF, alone + CAMERA_DOF)):
            raise FactorError(
                f"{self.name}: a covariance of shape {matrix.shape}, where {alone} rows and columns are due, "
                f"or {alone + CAMERA_DOF} with the camera's"
            )
        if not np.isfinite(matrix).all():
            raise SolveError(f"{self.name}: its covariance is not finite; does the graph determine it?")
        return matrix


class Match(NamedTuple):
    """A detection of a mapped object."""

    detection: int
    object: int
    reason: str
    mahalanobis: float
    """Distance (not squared) of the two, over as many directions as the reason says."""
    overlap: float
    """Share of the detection's points on the object's surface."""


class Unmatched(NamedTuple):
    """A detection of nothing that is mapped."""

    detection: int
    reason: str


@dataclass(frozen=True)
class Association:
    """What the detections of one frame are; each index occurs once, in the order of the detections."""

    matches: tuple[Match, ...] = ()
    new: tuple[Unmatched, ...] = ()
    """Detections to start objects from."""
    dropped: tuple[Unmatched, ...] = ()
    """Detections that say too little to be used."""


class Merge(NamedTuple):
    """Two mapped objects that are one."""

    keep: int
    """The better determined."""
    drop: int
    reason: str
    mahalanobis: float
    overlap: float
