"""Toy objects to compare methods on, and methods whose errors are known; no learnt weights, no search for a start."""

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from multiprocessing import parent_process
from typing import Any

import gtsam
import numpy as np

from factors.state import ObjectState
from objgraph.bench.comparison.contenders.methods import METHODS, Method
from objgraph.bench.comparison.objects import config as comparison_config
from objgraph.bench.comparison.objects import measure, starts
from objgraph.bench.comparison.objects.config import ComparisonConfig
from objgraph.bench.comparison.objects.rows import ObjectRow
from objgraph.covariance.labelled import RIGID_AXES, ObjectCovariance
from objgraph.datasets.ground_truth import AnnotatedScan, GroundTruth
from objgraph.errors import ObservationError, SolveError
from objgraph.estimate.task import Estimate, EstimationTask
from objgraph.graph.initialise import FirstStates, InitialisationConfig
from objgraph.observation.frames import Instance, ListedFrames
from objgraph.observation.sampling import SamplingConfig
from tests.toys import TOY_CODE, toy_frame, toy_mesh, toy_prior, toy_state

FAST = ComparisonConfig(
    mesh_resolution=24,
    surface_points=400,
    kept_points=30,
    sampling=SamplingConfig(points=60, hits=30, free=30),
    initialisation=InitialisationConfig(headings=4),
)
THIN = SamplingConfig(points=40, hits=20, free=20)
UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class FakeCase:
    """A toy chair; `fault` says what is wrong with it."""

    index: int
    category: str = "chair"
    fault: str = ""

    @property
    def difficulty(self) -> str:
        return ""

    @property
    def shapes(self) -> str:
        return "toys"

    @property
    def id(self) -> str:
        return f"{self.category}-{self.index}"

    @property
    def shape(self) -> str:
        return f"shape-{self.index // 2}"

    @property
    def instance(self) -> Instance:
        return Instance(1, self.category)

    def state(self) -> ObjectState:
        return toy_state(0.3 + self.index)

    def scan(self) -> AnnotatedScan:
        if self.fault == "dies":
            os._exit(3)
        if self.fault == "scan":
            raise OSError("the disk is gone")
        state = self.state()
        mesh = toy_mesh(state.code)
        truth = GroundTruth(
            state.T_world_object.matrix(), state.scale, np.asarray(mesh.vertices), np.asarray(mesh.faces)
        )
        frames = [
            toy_frame([state], azimuth, f"{self.index}/{i}", seed=i)
            for i, azimuth in enumerate((0.9, 1.7, 2.4))
        ]
        if self.fault == "masks":
            for frame in frames:
                frame.instances[:] = 0
        return AnnotatedScan(self.id, ListedFrames(frames), (self.instance,), UP, {1: truth})

    def views(self, count: int) -> tuple[int, ...]:
        if self.fault == "views":
            raise ObservationError("no frame sees it")
        return tuple(range(count))


@dataclass(frozen=True)
class FakeSource:
    """The given cases."""

    given: tuple[FakeCase, ...]
    seed: int = 0

    @property
    def dataset(self) -> str:
        return "fake"

    def settings(self) -> dict[str, Any]:
        return {"seed": self.seed, "range_m": (0.4, 6.0)}

    def cases(self, progress: Callable[[int, int], None] | None = None) -> Sequence[FakeCase]:
        return self.given


@dataclass(frozen=True)
class FakeEstimator:
    """Moves the start by a fixed step; `fault` says how it fails."""

    step: float = 0.0
    fault: str = ""
    covariance: bool = True

    def estimate(self, tasks: Sequence[EstimationTask], progress: Any = None) -> list[Estimate | SolveError]:
        return [self._one(task) for task in tasks]

    def _one(self, task: EstimationTask) -> Estimate | SolveError:
        assert len(task.starts) == 1
        if self.fault == "solve":
            return SolveError(f"{task.name}: it does not converge")
        if self.fault == "raise":
            raise RuntimeError("a bug")
        delta = np.zeros(9 + TOY_CODE)
        delta[3:6] = [self.step, 0, 0]
        state = task.starts[0].retract(delta)
        if self.fault == "empty":
            state = replace(state, code=np.array([-10.0, -10.0, 0.0, -10.0]))
        axes = (*RIGID_AXES, *(f"code_{i} [1]" for i in range(TOY_CODE)))
        covariance = ObjectCovariance(np.diag(np.linspace(1e-5, 1e-3, len(axes))), axes, "fake")
        points = sum(len(view.points_camera) for view in task.views)
        cost = float("nan") if self.fault == "nan" else 2.0
        return Estimate(state, covariance if self.covariance else None, cost, 1.0, points, len(task.views))


FAKES = {
    "near": Method(FakeEstimator, FAST.sampling),
    "far": Method(lambda: FakeEstimator(step=0.3), THIN),
    "bare": Method(lambda: FakeEstimator(step=0.01, covariance=False), FAST.sampling),
    "fails": Method(lambda: FakeEstimator(fault="solve"), FAST.sampling),
    "raises": Method(lambda: FakeEstimator(fault="raise"), FAST.sampling),
    "empty": Method(lambda: FakeEstimator(fault="empty"), FAST.sampling),
    "nan": Method(lambda: FakeEstimator(fault="nan"), FAST.sampling),
}


def _first_states(prior, views, builder, config) -> FirstStates:
    """A centimetre beside the truth, which the frames' names tell."""
    state = FakeCase(int(views[0].frame.split("/")[0])).state()
    aside = gtsam.Pose3(gtsam.Rot3.Ry(0.02), np.array([0.0, 0.0, 0.01]))
    return FirstStates((replace(state, T_world_object=state.T_world_object.compose(aside)),))


def install(patch: Any = None) -> None:
    """Put the fakes in place of what is real: for a test, or for good in a process that a test has spawned."""
    put = setattr if patch is None else patch.setattr
    for module in (measure, comparison_config):
        put(module, "find_prior", lambda category, files: toy_prior())
    put(starts, "first_states", _first_states)
    for name, method in FAKES.items():
        METHODS[name] = method if patch is None else METHODS.get(name, method)
        if patch is not None:
            patch.setitem(METHODS, name, method)


def row(method: str = "near", case: str = "chair-0", views: int = 1, **values: Any) -> ObjectRow:
    """A row without the work."""
    return ObjectRow(
        method,
        "fake",
        case,
        values.pop("category", "chair"),
        values.pop("shape", case),
        views,
        values.pop("settings", "s"),
        [0],
        **values,
    )


if parent_process() is not None:
    # spawned by a test to which METHODS and the rest are not passed on
    install()
