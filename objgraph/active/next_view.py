"""Which view to take next: what each candidate camera is expected to tell, from the estimate alone.

No image is needed: a camera sees those points of the estimated surfaces that face it, lie in its picture and are hidden by
nothing, and a point tells what the 3D and the 2D factor would make of it there. Linearised once at the estimate, a
candidate's expected information is H = sum_i w_i J_i^T J_i over what it sees, and its gain of information
1/2 log det(I + Sigma H): the mutual information of state and measurement under the Gaussian (Lindley 1956;
MacKay, "Information-based objective functions for active data selection", 1992).

Views see the same surface with noise of their own but share what the decoder cannot make of it. The mean of measurements
of one point with precisions n_v has the variance r^2 + 1 / sum n_v, so a view after others adds w = f(sum + n) - f(sum)
with f(n) = n / (1 + r^2 n): next to nothing where noise is small against r, and a view of the other side tells more.

What no view has seen is not known, whatever the marginals say: the prior's shapes are not the real ones. So a side of the box
and a piece of surface err by far less once they have been seen (`objgraph.covariance.sides`).
"""

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Literal, get_args

import gtsam
import numpy as np
from jaxtyping import Bool, Float
from scipy.sparse import eye_array
from scipy.spatial import cKDTree

from factors import checks
from factors.checks import PLACES
from factors.state import RIGID_DOF
from objgraph.active.headings import OtherHeading, risk
from objgraph.active.surface_sample import SurfaceSample
from objgraph.active.target import Target
from objgraph.covariance.sides import SEEN_M, SideMisfit, seen_sides
from objgraph.errors import ActiveVisionError, ConfigError
from objgraph.observation.frames import Intrinsics
from objgraph.observation.sampling import SamplingConfig, SensorNoise, independent_shares

if TYPE_CHECKING:
    import open3d as o3d

log = logging.getLogger(__name__)

Criterion = Literal["corners", "pose", "information", "surface"]
_FACTORS = 2.0
"""The 3D and the 2D factor, each of which counts what it sees."""
_GRAZING = 0.1
"""Cosine between the surface's normal and the line of sight below which depth is not measured."""
_SATURATED = 9.0
"""Squared residual over variance beyond which the factors' robust losses count little more."""
_HIDDEN = 0.02
"""Metres in front of a point at which something hides it: less is the surface itself."""


@dataclass(frozen=True)
class NextViewConfig:
    """The camera to be moved, and how its measurements will be weighed."""

    intrinsics: Intrinsics = field(default_factory=lambda: Intrinsics(525.0, 525.0, 319.5, 239.5, 640, 480))
    noise: SensorNoise = field(default_factory=SensorNoise)
    near: float = 0.3
    """Depths closer than this are not measured, metres."""
    far: float = 5.0
    correlation_length: float = SamplingConfig.correlation_length
    """As `SamplingConfig.correlation_length`."""
    min_share: float = 0.1
    """Of an object's surface that must be seen for the view to be one of it."""
    sides: SideMisfit = field(default_factory=lambda: SideMisfit(marginals=4.0, seen=0.01, unseen=0.1))
    """How far a side that was seen, and one that was not, lies from the estimate's: about what calibrations of chairs and
    tables have."""

    def __post_init__(self) -> None:
        """Raises ConfigError where a number is not one of its kind."""
        checks.settings(
            self, ConfigError, far=checks.POSITIVE, correlation_length=checks.Range(1e-3, 1e4),
            min_share=checks.Range(0, 1),
        )  # fmt: skip


@dataclass(frozen=True)
class ObjectGain:
    """What a view is expected to tell of one object."""

    information: float
    """Expected gain of information on pose, scale and code together, nats."""
    pose: float
    """The same on the 9-DoF pose alone."""
    surface: float
    """Expected decrease of the mean variance over the whole surface, square metres, what is first seen counted."""
    corners: float
    """Expected decrease of the mean square error of the box's corners, square metres: by what is learnt of the pose, by sides
    that are first seen, and by what tells the heading from the others that the object may have."""
    seen: float
    """Share of the surface's points that are seen."""


@dataclass(frozen=True)
class ViewGain:
    """What a camera at T_world_camera is expected to tell of each object."""

    T_world_camera: gtsam.Pose3
    objects: dict[str, ObjectGain]

    def total(self, criterion: Criterion = "corners") -> float:
        """Over all objects: what they do not share is added up."""
        return sum(getattr(gain, criterion) for gain in self.objects.values())


def next_views(
    objects: Sequence[Target],
    cameras: Sequence[gtsam.Pose3],
    config: NextViewConfig | None = None,
    *,
    criterion: Criterion = "corners",
    others: Sequence[tuple[np.ndarray, np.ndarray]] = (),
    progress: Callable[[int, int], None] | None = None,
) -> list[ViewGain]:
    """The candidates, the most telling first; thousands take seconds.

    `others` are meshes (vertices in the world, faces) that only hide: walls, furniture that is not asked about.

    Raises:
        ActiveVisionError: there is no object, or no camera, or two objects have one name.
    """
    objects = checks.tuple_of("objects", objects, Target, ActiveVisionError)
    cameras = checks.tuple_of("cameras", cameras, gtsam.Pose3, ActiveVisionError)
    if not objects or not cameras:
        raise ActiveVisionError(f"{len(objects)} objects and {len(cameras)} cameras: both must be some")
    names = [target.name for target in objects]
    if twice := {name for name in names if names.count(name) > 1}:
        raise ActiveVisionError(
            f"several objects are called {', '.join(sorted(twice))}: give each a name of its own"
        )
    for camera in cameras:
        checks.pose("a camera", camera, ActiveVisionError)
    if not isinstance(criterion, str) or criterion not in get_args(Criterion):
        raise ActiveVisionError(
            f"criterion must be one of {', '.join(get_args(Criterion))}, not {criterion!r}"
        )
    config = checks.settings_or_default(config, NextViewConfig, ConfigError)
    # rays are single precision's: far from the world's origin the scene is moved there, by whole hundreds of metres
    to_here = gtsam.Pose3(gtsam.Rot3(), -np.round(objects[0].centre, -2))
    objects = [_moved(to_here, target) for target in objects]
    meshes = [(target.vertices, target.faces) for target in objects]
    others = [
        _checked(i, mesh)
        for i, mesh in enumerate(checks.tuple_of("others", others, tuple, ActiveVisionError))
    ]
    others = [(vertices + to_here.translation(), faces) for vertices, faces in others]
    scene = _scene([*meshes, *others])
    gains: list[dict[str, ObjectGain]] = [{} for _ in cameras]
    for i, target in enumerate(objects):
        rest = [*meshes[:i], *meshes[i + 1 :], *others]
        turned = [_scene([(other.vertices, other.faces), *rest]) for other in target.others]
        judge = _Judge(target, scene, turned, config)
        for gain, camera in zip(gains, cameras, strict=True):
            gain[target.name] = judge.gain(to_here.compose(camera))
        if progress is not None:
            progress(i + 1, len(objects))
    found = [ViewGain(camera, gain) for camera, gain in zip(cameras, gains, strict=True)]
    return sorted(found, key=lambda view: -view.total(criterion))


def _moved(T: gtsam.Pose3, target: Target) -> Target:
    """The same target in a world that is moved."""
    by, state = T.translation(), target.state
    others = tuple(
        replace(other, points=other.points + by, vertices=other.vertices + by) for other in target.others
    )
    return replace(
        target,
        points=target.points + by,
        vertices=target.vertices + by,
        state=replace(state, T_world_object=T.compose(state.T_world_object)),
        seen_from=tuple(T.compose(camera) for camera in target.seen_from),
        others=others,
    )


def _checked(i: int, mesh: tuple[np.ndarray, ...]) -> tuple[np.ndarray, np.ndarray]:
    """A mesh that only hides; raises ActiveVisionError where it is none."""
    if len(mesh) != 2:
        raise ActiveVisionError(f"others[{i}] must be vertices and faces, not {len(mesh)} things")
    vertices = checks.reals(f"vertices of others[{i}]", mesh[0], (None, 3), PLACES, ActiveVisionError)
    faces = checks.array(f"faces of others[{i}]", mesh[1], (None, 3), ActiveVisionError, kinds="iu")
    if not len(faces) or faces.min() < 0 or faces.max() >= len(vertices):
        raise ActiveVisionError(
            f"faces of others[{i}] name vertices outside 0..{len(vertices) - 1}, or are none"
        )
    return vertices, faces


def _scene(meshes: Sequence[tuple[np.ndarray, np.ndarray]]) -> "o3d.t.geometry.RaycastingScene":
    import open3d as o3d  # slow to import, and not needed for the types above

    scene = o3d.t.geometry.RaycastingScene()
    for vertices, faces in meshes:
        scene.add_triangles(np.asarray(vertices, np.float32), np.asarray(faces, np.uint32))
    return scene


def known_precision(
    target: Target, scene: "o3d.t.geometry.RaycastingScene", config: NextViewConfig
) -> Float[np.ndarray, "m"]:
    """Sum of the sensor's precisions, 1 / m^2, with which the views so far have measured each of the object's points.

    They are taken to be of the same camera as the candidates; views that all see nothing in its range are warned of.
    """
    precision = np.zeros(len(target.points))
    for camera in target.seen_from:
        seen = visible(target, camera, scene, config)
        precision[seen] += config.noise(_in_camera(target.points[seen], camera)[:, 2]) ** -2
    if target.seen_from and not precision.any():
        log.warning(
            "%s counts as never seen: none of the %d views so far sees it between %g and %g m",
            target.name, len(target.seen_from), config.near, config.far,
        )  # fmt: skip
    return precision


def expected_information(
    target: Target,
    T_world_camera: gtsam.Pose3,
    seen: Bool[np.ndarray, "m"],
    config: NextViewConfig,
    precision: Float[np.ndarray, "m"] | None = None,
) -> Float[np.ndarray, "d d"]:
    """What a view that sees these points is expected to add to the object's information matrix.

    `precision` is what other views have measured the points with (`known_precision`); None where there were none.
    """
    share, depth = _shares(target, T_world_camera, seen, config)
    before = np.zeros(len(share)) if precision is None else precision[seen]
    after = before + config.noise(depth) ** -2
    shared = target.residual[seen] ** 2
    weight = after / (1 + shared * after) - before / (1 + shared * before)
    jacobian = target.jacobian[seen]
    return _FACTORS * (jacobian * (share * weight)[:, None]).T @ jacobian


def divergence(
    surface: SurfaceSample,
    distance: Float[np.ndarray, "m"],
    T_world_camera: gtsam.Pose3,
    scene: "o3d.t.geometry.RaycastingScene",
    config: NextViewConfig,
) -> float:
    """Cost that a view of this surface is expected to put on one at these distances from its points: half squared distances,
    as the factors' scores nearly are while they are small."""
    seen = visible(surface, T_world_camera, scene, config)
    if seen.mean() < config.min_share:
        return 0.0
    share, depth = _shares(surface, T_world_camera, seen, config)
    squared = distance[seen] ** 2 / (config.noise(depth) ** 2 + surface.residual[seen] ** 2)
    return _FACTORS * 0.5 * float(share @ np.minimum(squared, _SATURATED))


def _shares(
    surface: SurfaceSample, T_world_camera: gtsam.Pose3, seen: Bool[np.ndarray, "m"], config: NextViewConfig
) -> tuple[Float[np.ndarray, "s"], Float[np.ndarray, "s"]]:
    """What each point that is seen counts for, and its depth."""
    p_camera = _in_camera(surface.points[seen], T_world_camera)
    return independent_shares(p_camera, config.correlation_length, most=0.25), p_camera[:, 2]


def visible(
    surface: SurfaceSample,
    T_world_camera: gtsam.Pose3,
    scene: "o3d.t.geometry.RaycastingScene",
    config: NextViewConfig,
) -> Bool[np.ndarray, "m"]:
    """Which of the object's points face the camera, lie in its picture and range, and are hidden by nothing."""
    p_camera = _in_camera(surface.points, T_world_camera)
    depth = p_camera[:, 2]
    intrinsics = config.intrinsics
    seen = (depth > config.near) & (depth < config.far)
    pixel = np.round(intrinsics.project(np.where(seen[:, None], p_camera, [[0.0, 0.0, 1.0]])))
    seen &= (pixel >= 0).all(axis=1) & (pixel < [intrinsics.width, intrinsics.height]).all(axis=1)
    sight = surface.points - T_world_camera.translation()
    distance = np.linalg.norm(sight, axis=1)
    seen &= -(sight * surface.normals).sum(axis=1) > _GRAZING * distance
    if seen.any():
        eye = np.broadcast_to(T_world_camera.translation(), sight[seen].shape)
        rays = np.concatenate([eye, sight[seen] / distance[seen, None]], axis=1).astype(np.float32)
        import open3d as o3d  # as in _scene

        first = scene.cast_rays(o3d.core.Tensor(rays))["t_hit"].numpy()
        seen[seen] = first > distance[seen] - _HIDDEN
    return seen


class _Judge:
    """One object's gains: what does not depend on the camera is computed once."""

    def __init__(
        self,
        target: Target,
        scene: "o3d.t.geometry.RaycastingScene",
        turned: "Sequence[o3d.t.geometry.RaycastingScene]",
        config: NextViewConfig,
    ) -> None:
        """`turned` are the scenes in which the object stands in its other headings."""
        self.target, self.scene, self.turned, self.config = target, scene, turned, config
        self.precision = known_precision(target, scene, config)
        tree = cKDTree(target.points)
        apart = tree.sparse_distance_matrix(tree, SEEN_M, output_type="coo_matrix").tocsr()
        self.near = (apart > 0) + eye_array(len(target.points), dtype=bool, format="csr")
        self.seen = self._known(self.precision > 0)
        self.extents = np.ptp(target.state.to_object(target.vertices), axis=0) * target.state.scale
        self.unseen, self.sides = self._unseen(self.seen), self._sides(self.seen)
        self.covariance = np.linalg.inv(target.information)
        self.log_det = np.linalg.slogdet(target.information)[1]
        self.pose_log_det = np.linalg.slogdet(self.covariance[:RIGID_DOF, :RIGID_DOF])[1]
        self.surface = target.surface_misfit * target.jacobian.T @ target.jacobian / len(target.jacobian)
        self.variance = float((self.surface * self.covariance).sum())
        self.corners = target.corner_jacobian.T @ target.corner_jacobian / 8
        self.risk = risk(target.probability, target.others, [0.0] * len(target.others))

    def gain(self, camera: gtsam.Pose3) -> ObjectGain:
        seen = visible(self.target, camera, self.scene, self.config)
        share = float(seen.mean())
        if share < self.config.min_share:
            return ObjectGain(0.0, 0.0, 0.0, 0.0, share)
        added = expected_information(self.target, camera, seen, self.config, self.precision)
        information = self.target.information + added
        after = np.linalg.inv(information)
        rigid = after[:RIGID_DOF, :RIGID_DOF]
        less = self.covariance[:RIGID_DOF, :RIGID_DOF] - rigid
        known = self.seen | self._known(seen)
        corners = self.config.sides.marginals * float((self.corners * less).sum())
        return ObjectGain(
            0.5 * float(np.linalg.slogdet(information)[1] - self.log_det),
            0.5 * float(self.pose_log_det - np.linalg.slogdet(rigid)[1]),
            self.variance - float((self.surface * after).sum()) + self.unseen - self._unseen(known),
            corners + self.sides - self._sides(known) + self._heading(camera),
            share,
        )

    def _known(self, seen: Bool[np.ndarray, "m"]) -> Bool[np.ndarray, "m"]:
        """Points that were seen, and those near them."""
        return self.near @ seen

    def _unseen(self, seen: Bool[np.ndarray, "m"]) -> float:
        """Mean square of how far the surface may lie from where it is estimated, square metres."""
        misfit = self.config.sides
        widest = max(misfit.unseen * self.extents.mean(), misfit.seen)
        return float(np.square(np.where(seen, misfit.seen, widest)).mean())

    def _sides(self, seen: Bool[np.ndarray, "m"]) -> float:
        """Mean square error of the corners that the sides' own errors make, square metres."""
        shares = seen_sides(self.target.state, self.target.points, seen, self.target.stands)
        return float(np.square(self.config.sides.sigma(self.extents, shares)).mean(axis=1).sum())

    def _heading(self, camera: gtsam.Pose3) -> float:
        """Expected decrease of the mean square error that the wrong heading makes, square metres."""
        nats = [
            self._apart(other, camera, scene) / self.target.temperature
            for other, scene in zip(self.target.others, self.turned, strict=True)
        ]
        return self.risk - risk(self.target.probability, self.target.others, nats)

    def _apart(
        self, other: OtherHeading, camera: gtsam.Pose3, scene: "o3d.t.geometry.RaycastingScene"
    ) -> float:
        """Cost between the object as it was found and turned, the mean of both views of it."""
        own = divergence(self.target, other.of_own, camera, self.scene, self.config)
        return 0.5 * (own + divergence(other, other.to_own, camera, scene, self.config))


def _in_camera(points: Float[np.ndarray, "n 3"], T_world_camera: gtsam.Pose3) -> Float[np.ndarray, "n 3"]:
    return (points - T_world_camera.translation()) @ T_world_camera.rotation().matrix()
