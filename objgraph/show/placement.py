"""Where an object of a map is drawn: its box, the ellipsoid of the box's centre, and the other headings it may have."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.stats import chi2

from factors.state import ObjectState
from objgraph.geometry.boxes import OrientedBox
from objgraph.maps.mapped_object import MappedObject
from objgraph.show import summary

LEVEL = 0.95
"""Of the ellipsoids."""
LEAST = 0.05
"""Probability of another heading below which it is neither drawn nor told."""


class Place(NamedTuple):
    """Where an object is said to be, and how well that is known."""

    T_world_object: Float[np.ndarray, "4 4"]
    centre: Float[np.ndarray, "3"]
    """Of its box where that has a covariance, its origin otherwise; world frame."""
    covariance: Float[np.ndarray, "9 9"] | None
    """Over `COVARIANCE_AXES` or `BOX_COVARIANCE_AXES`: rotation and translation in the object's axes come first."""
    is_calibrated: bool
    """Whether it is the box's; the estimator's own is too small."""


def place_of(entry: MappedObject) -> Place | None:
    """None of an object that has no place."""
    T_world_object = entry.T_world_object
    if T_world_object is None:
        return None
    if entry.box_centre is not None and entry.box_covariance is not None:
        return Place(T_world_object, entry.box_centre, entry.box_covariance, True)
    return Place(T_world_object, T_world_object[:3, 3], entry.covariance, False)


class Ellipsoid(NamedTuple):
    """The region about a position that holds it with probability `LEVEL`, world frame."""

    centre: Float[np.ndarray, "3"]
    rotation: Float[np.ndarray, "3 3"]
    """Its axes as columns, a right-handed frame."""
    half_sizes: Float[np.ndarray, "3"]
    """Metres."""

    @staticmethod
    def of(centre: Float[np.ndarray, "3"], covariance_world: Float[np.ndarray, "3 3"]) -> "Ellipsoid":
        """Of a position with its covariance, m^2."""
        variances, axes = np.linalg.eigh(covariance_world)
        axes[:, 0] *= np.sign(np.linalg.det(axes))
        return Ellipsoid(centre, axes, np.sqrt(variances.clip(min=1e-12) * chi2.ppf(LEVEL, 3)))

    @property
    def matrix(self) -> Float[np.ndarray, "4 4"]:
        """What makes the unit sphere this ellipsoid."""
        return scaled_frame(self.centre, self.rotation, self.half_sizes)


class Heading(NamedTuple):
    """Another heading that an object may have."""

    quarter: int
    """Quarter turns about its up axis."""
    probability: float
    moved_world: Float[np.ndarray, "4 4"]
    """What moves the mesh there; the shape is that of the likeliest heading."""


def centre_ellipsoid(entry: MappedObject) -> Ellipsoid | None:
    """Of the place that an object is said to be at; None where nothing says how well that is known."""
    place = place_of(entry)
    if place is None or place.covariance is None:
        return None
    return Ellipsoid.of(place.centre, summary.position_covariance(place.T_world_object, place.covariance))


def box_of(entry: MappedObject) -> OrientedBox | None:
    """The box that has a covariance, else the one about the mesh; None without a mesh."""
    if entry.T_world_object is None or entry.vertices is None:
        return None
    R = entry.T_world_object[:3, :3]
    if entry.box_centre is not None and entry.box_extents is not None:
        return OrientedBox(entry.box_centre, R, entry.box_extents)
    return OrientedBox.about(entry.vertices, R)


def size_of(entry: MappedObject) -> Float[np.ndarray, "3"] | None:
    """Edges of the box that is said where it is (`place_of`), metres: the one with a covariance, else the mesh's."""
    return entry.size_m if entry.box_extents is None else entry.box_extents


def headings_of(entry: MappedObject) -> list[Heading]:
    """Other headings that are likely enough to be drawn."""
    modes = entry.other_headings
    if modes is None or entry.turned is None:
        return []
    to_canonical = np.linalg.inv(_placed(entry.state))
    found = enumerate(zip(modes.probability, modes.states, strict=True))
    return [
        Heading(quarter, float(p), _placed(state) @ to_canonical)
        for quarter, (p, state) in found
        if quarter and state is not None and p > LEAST
    ]


def scaled_frame(
    centre: Float[np.ndarray, "3"], rotation: Float[np.ndarray, "3 3"], scale: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "4 4"]:
    """What takes the unit box or sphere about the origin to this place, its columns scaled."""
    matrix = np.eye(4)
    matrix[:3, :3] = rotation * scale
    matrix[:3, 3] = centre
    return matrix


def _placed(state: ObjectState) -> Float[np.ndarray, "4 4"]:
    """T_world_object with its scale: from canonical units to metres in the world."""
    return state.T_world_object.matrix() @ np.diag([*state.scale, 1.0])
