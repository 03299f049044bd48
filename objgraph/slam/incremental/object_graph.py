"""Frames in, a map out, one frame after the other: objects and cameras in one incremental smoother."""

from collections.abc import Callable, Sequence

import gtsam
import numpy as np
from gtsam.symbol_shorthand import X
from jaxtyping import Float

from factors import checks
from factors.keys import readable_key
from factors.state import ObjectKeys
from objgraph.errors import ConfigError, ObservationError, SolveError
from objgraph.graph.builder import ObjectBuilder
from objgraph.graph.object_graph import ObjectGraph
from objgraph.observation.frames import Frame, Instance
from objgraph.observation.sampling import rigid_pose
from objgraph.priors.registry import prior_for
from objgraph.priors.shape_prior import ShapePrior
from objgraph.slam.incremental.config import IncrementalConfig
from objgraph.slam.incremental.front_end import FrameReport, FrontEnd, checked
from objgraph.slam.incremental.motion import Motion, anchored, moved
from objgraph.slam.incremental.smoother import Smoother
from objgraph.slam.incremental.system import IncrementalSystem
from objgraph.work import torch_threads

_CLOSED_LOOP = 0.03
"""Metres by which a frame moves its camera where more of the map may have moved than what the frame saw."""


class IncrementalObjectGraph(FrontEnd):
    """A map of objects and cameras that grows by `update`.

    Each observation enters ISAM2 as the quadratic of its two factors, so that the smoother calls back into Python for
    none of them, though it does for the prior of codes that are of several kinds (`ShapePrior.kinds`). An observation is
    linearised anew, and replaced, once the object has moved in the camera's frame, or its scale or code has changed. Before that the frame's camera and objects are solved against the map's own marginal: far starts
    never reach the smoother. Objects enter once they have been seen from two directions.
    """

    def __init__(
        self,
        up_world: Float[np.ndarray, "3"],
        *,
        floor: float | None = None,
        config: IncrementalConfig | None = None,
        find_prior: Callable[[str], ShapePrior] = prior_for,
        body_T_camera: gtsam.Pose3 | None = None,
        object_keys: Callable[[int], ObjectKeys] = ObjectKeys.numbered,
    ) -> None:
        """`up_world` is the unit vector against gravity in the first frame's world, `floor` the floor's height along it.

        With `body_T_camera` the poses of the graph are those of the body that the camera is fixed on; frames still come
        with the camera's. `object_keys` gives the keys of the n-th object.
        """
        config = checks.settings_or_default(config, IncrementalConfig, ConfigError)
        up_world = checks.direction("up_world", up_world, ObservationError)
        builder = ObjectBuilder(config.graph, up_world, floor)
        self._smoother = Smoother(config.lag)
        system = IncrementalSystem(config, builder, self._smoother, body_T_camera)
        super().__init__(system, find_prior, object_keys)
        self._odometry: gtsam.Pose3 | None = None

    @property
    def next_camera(self) -> int:
        """The key that the next frame's camera will have, unless another is given."""
        index = len(self.cameras)
        while X(index) in self.cameras or self._smoother.has(X(index)):
            index += 1
        return X(index)

    @torch_threads(1)
    def update(
        self,
        frame: Frame,
        detections: Sequence[Instance],
        *,
        camera: int | None = None,
        factors: Sequence[gtsam.NonlinearFactor] = (),
        values: gtsam.Values | None = None,
    ) -> FrameReport:
        """Take in one frame and what its masks show.

        The frame's pose is the odometry's: the motion since the last frame is what is used of it, and where the first
        one stands the map begins. `detections` name the frame's masks; an id means nothing beyond its frame. `camera`
        is the key of the frame's pose, by default `next_camera`. `factors` and `values` are further ones of the caller's
        own, which may be on that key.

        Raises:
            ObservationError: the frame's pose is no rigid motion, or two detections have one id.
            SolveError: the key is taken, or the update cannot be solved, for instance because a variable of the caller's
                is not determined. In any case the map is as it was before.
        """
        detections, where = checked(frame, detections), f"frame {frame.name}"
        factors = checks.tuple_of(f"{where}: factors", factors, gtsam.NonlinearFactor, SolveError)
        if values is not None:
            checks.instance(f"{where}: values", values, gtsam.Values, SolveError)
        camera = self.next_camera if camera is None else checks.key(f"{where}: camera", camera, SolveError)
        if self.system.smoother.has(camera) or camera in self.cameras:
            raise SolveError(f"{where}: {readable_key(camera)} is in the map already: give another key")
        if values is not None and values.exists(camera):
            raise SolveError(
                f"{where}: {readable_key(camera)}, the frame's own pose, must not be among `values`"
            )
        motion = self._motion(frame, camera)
        sightings = self.sightings(frame, detections, motion)
        self.take_in(frame, camera, motion, sightings.seen, factors, values)

        self._odometry = motion.odometry
        jump = motion.predicted.localCoordinates(self.pose(camera))[3:]
        closed = bool(np.linalg.norm(jump) > _CLOSED_LOOP)
        seen = [entry for entry, _ in sightings.seen]
        reasons = self.keep_current(seen, everything=closed)
        entered, why = self.wait(sightings, camera)
        names = tuple(entry.name for entry in seen)
        reasons = (*sightings.reasons, *reasons, *why)
        return FrameReport(frame.name, camera, names, tuple(entered), self.pending, reasons)

    def estimate(self) -> gtsam.Values:
        """Every variable's estimate; the larger the map, the longer it takes."""
        return self._smoother.estimate()

    @torch_threads(1)
    def optimize(self, rounds: int = 2) -> None:
        """Solve the whole map as one nonlinear problem, each round with samples drawn where the last one ended.

        Costs as much as the map is large. What it finds is the optimum of `batch()` as that is frozen afterwards.

        Raises:
            SolveError: `rounds` is no whole number of at most 1000, or the map cannot be solved as a whole; it is as it
                was before.
        """
        rounds = checks.whole("rounds", rounds, checks.Range(0, 1000), SolveError)
        self.system.solve_whole(rounds)
        self.places.note(self.objects)

    def batch(self) -> ObjectGraph:
        """The map as one nonlinear graph of its own, at the current estimate: to be optimised as a whole, or saved."""
        return self.system.batch()

    def _motion(self, frame: Frame, camera: int) -> Motion:
        odometry = self.system.body_of(rigid_pose(frame, f"frame {frame.name}"))
        if self._odometry is None:
            return anchored(camera, odometry, self.config)
        previous = next(reversed(self.cameras))
        noise = self.config.odometry
        return moved(previous, camera, self.pose(previous), self._odometry, odometry, noise)
