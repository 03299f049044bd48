"""What a LiDAR and a detector say about a scene: one scan of points, boxes about objects, and maybe a picture."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int, UInt8

from factors import checks
from factors.checks import DEVIATIONS, PLACES
from objgraph.errors import ObservationError
from objgraph.geometry.boxes import OrientedBox
from objgraph.geometry.frames import transformed, transformed_back, why_not_rigid
from objgraph.observation.frames import IDS, Intrinsics, check_colors, check_sizes


def rigid(what: str, T: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "4 4"]:
    """The matrix; raises ObservationError where it is no rotation and translation."""
    if (why := why_not_rigid(T)) is not None:
        raise ObservationError(f"{what} is no rigid motion: {why}")
    return T


@dataclass(frozen=True)
class Detection:
    """An object as a detector's box has it."""

    id: int
    """Its value in the masks, where there are any; from 1 on."""
    category: str
    T_world_object: Float[np.ndarray, "4 4"]
    """Rigid: the box's middle, and its axes as the priors have them: y up, front at -z."""
    size: Float[np.ndarray, "3"]
    """Edges along the object's x (width), y (height) and z (length), metres."""
    score: float | None = None

    def __post_init__(self) -> None:
        """Raises ObservationError where the box is none."""
        checks.text(f"the category of detection {self.id}", self.category, ObservationError)
        checks.whole(f"the id of a detected {self.category}", self.id, IDS, ObservationError)
        what = f"{self.name}: leave the detection out, its"
        T = checks.reals(f"{what} T_world_object", self.T_world_object, (4, 4), PLACES, ObservationError)
        size = checks.reals(f"{what} edges", self.size, (3,), DEVIATIONS, ObservationError)
        object.__setattr__(self, "T_world_object", rigid(f"{what} T_world_object", T))
        object.__setattr__(self, "size", size)

    @property
    def name(self) -> str:
        return f"{self.category} {self.id}"

    @property
    def box(self) -> OrientedBox:
        return OrientedBox(self.T_world_object[:3, 3], self.T_world_object[:3, :3], self.size)

    def to_box(self, p_world: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """World points in the box's own frame, metres."""
        return transformed_back(self.T_world_object, p_world)

    def outside(self, p_world: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n"]:
        """How far points are outside of the box, along the axis where most; negative inside. Metres."""
        return (np.abs(self.to_box(p_world)) - self.size / 2).max(axis=1)


@dataclass(frozen=True)
class Picture:
    """A camera's picture beside the scan."""

    color: UInt8[np.ndarray, "h w 3"]
    """RGB."""
    intrinsics: Intrinsics
    T_world_camera: Float[np.ndarray, "4 4"]
    instances: Int[np.ndarray, "h w"] | None = None
    """Id of the detection that a pixel shows; 0 where none. None where nobody segmented the picture."""

    def __post_init__(self) -> None:
        """Raises ObservationError where an image is none of numbers, or of another size than the intrinsics."""
        checks.instance("a picture's intrinsics", self.intrinsics, Intrinsics, ObservationError)
        color = checks.array("a picture's color", self.color, (None, None, 3), ObservationError, kinds="u")
        T = checks.reals("a picture's T_world_camera", self.T_world_camera, (4, 4), PLACES, ObservationError)
        check_colors("a picture", color)
        object.__setattr__(self, "color", color)
        object.__setattr__(self, "T_world_camera", T)
        if self.instances is not None:
            ids = checks.array(
                "a picture's instances", self.instances, (None, None), ObservationError, kinds="iu"
            )
            object.__setattr__(self, "instances", ids)
        check_sizes("a picture", self.intrinsics, colour=self.color, instance=self.instances)

    def ids_at(self, p_world: Float[np.ndarray, "n 3"]) -> Int[np.ndarray, "n"]:
        """The mask's id at each world point; -1 where the point is not in the picture or nobody segmented it."""
        ids = np.full(len(p_world), -1)
        if self.instances is None:
            return ids
        T = self.T_world_camera
        p_camera = transformed_back(T, p_world)
        ahead = np.flatnonzero(p_camera[:, 2] > 0.1)
        u, v = np.round(self.intrinsics.project(p_camera[ahead])).T
        inside = (u >= 0) & (u < self.intrinsics.width) & (v >= 0) & (v < self.intrinsics.height)
        ids[ahead[inside]] = self.instances[v[inside].astype(int), u[inside].astype(int)]
        return ids


@dataclass(frozen=True)
class LidarFrame:
    """One scan of a LiDAR, and what a detector found in it."""

    name: str
    p_lidar: Float[np.ndarray, "n 3"]
    """Returns in metres, in axes like a camera's: x right, y down, z ahead."""
    T_world_lidar: Float[np.ndarray, "4 4"]
    """LiDAR to world, rigid; rays begin at its origin."""
    up_world: Float[np.ndarray, "3"]
    """Unit vector against gravity, as far as it is known without looking at the road."""
    detections: tuple[Detection, ...]
    picture: Picture | None = None
    others: tuple[Detection, ...] = ()
    """Found, too, and not to be estimated: returns that are nearer to one of these are no detection's."""

    def __post_init__(self) -> None:
        """Raises ObservationError where it is no scan; returns that are not finite may be in it, and say nothing."""
        where = f"frame {checks.text('the name of a scan', self.name, ObservationError)}"
        points = checks.array(f"{where}: p_lidar", self.p_lidar, (None, 3), ObservationError, finite=False)
        T = checks.reals(f"{where}: T_world_lidar", self.T_world_lidar, (4, 4), PLACES, ObservationError)
        object.__setattr__(self, "p_lidar", points)
        object.__setattr__(self, "T_world_lidar", rigid(f"{where}: T_world_lidar", T))
        up = checks.direction(f"{where}: up_world", self.up_world, ObservationError)
        object.__setattr__(self, "up_world", up)
        found = checks.tuple_of(f"{where}: detections", self.detections, Detection, ObservationError)
        object.__setattr__(self, "detections", found)
        others = checks.tuple_of(f"{where}: others", self.others, Detection, ObservationError)
        object.__setattr__(self, "others", others)
        ids = [each.id for each in (*found, *others)]
        if len(set(ids)) < len(ids):
            raise ObservationError(f"{where}: two detections have the same id; give each its own")
        if self.picture is not None:
            checks.instance(f"{where}: picture", self.picture, Picture, ObservationError)

    @cached_property
    def p_world(self) -> Float[np.ndarray, "n 3"]:
        """The returns in the world; asked for once an object."""
        return transformed(self.T_world_lidar, self.p_lidar)

    def detection(self, detection_id: int) -> Detection:
        """Raises ObservationError where there is none of that id."""
        for each in self.detections:
            if each.id == detection_id:
                return each
        known = ", ".join(str(each.id) for each in self.detections) or "none"
        raise ObservationError(f"frame {self.name}: no detection {detection_id}; there are: {known}")
