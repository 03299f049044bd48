"""What an `ObjectGraph` knows of one of its objects."""

from dataclasses import dataclass, field
from typing import NamedTuple

import gtsam

from factors.base import ObservationFactor
from factors.state import ObjectKeys
from objgraph.covariance.heading_modes import HeadingModes
from objgraph.observation.sampling import ObjectView
from objgraph.priors.shape_prior import ShapePrior


class Sighting(NamedTuple):
    """One view of an object, and from where: as `ObjectGraph.observe` was told."""

    view: ObjectView
    camera: gtsam.Pose3 | int
    body_T_camera: gtsam.Pose3 | None
    factors: tuple[ObservationFactor, ...] = ()
    slots: tuple[int, ...] = ()
    """The factors' indices in the caller's graph; none where they were added otherwise than by `observe`."""


@dataclass
class ObjectHandle:
    """One object of an `ObjectGraph`."""

    name: str
    keys: ObjectKeys
    prior: ShapePrior
    factors: list[ObservationFactor] = field(default_factory=list)
    """Those that use the decoder."""
    sightings: list[Sighting] = field(default_factory=list)
    """What it was observed in."""
    other_headings: HeadingModes | None = None
    """How likely it stands as estimated or turned, by the views that it was placed by."""
    slots: dict[int, gtsam.NonlinearFactor] = field(default_factory=dict)
    """All its factors by their index in the caller's graph."""
