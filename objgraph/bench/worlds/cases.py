"""The synthetic benchmark: one object a case, in a room of its own, seen in three views by a noisy sensor."""

import hashlib
from dataclasses import asdict, dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Literal, get_args

import gtsam
import numpy as np
from numpy.random import Generator

from objgraph.bench.worlds.difficult_views import draw_difficult_scene, visible_shares
from objgraph.bench.worlds.families import FAMILIES, make_piece
from objgraph.bench.worlds.meshes import CadShape, ShapeSet, choose_shapes, mesh_furniture
from objgraph.bench.worlds.viewpoints import VIEWS, Scene, Spacing, can_hold, draw_scene
from objgraph.datasets.ground_truth import AnnotatedScan, GroundTruth
from objgraph.errors import DatasetError
from objgraph.geometry.frames import transformed
from objgraph.observation.frames import Frame, Instance, ListedFrames
from objgraph.synthetic.camera import CameraConfig, Pose, camera_matrix, intrinsics
from objgraph.synthetic.faults import Difficulty, FaultRanges, Faults, ranges_of
from objgraph.synthetic.furniture import Category, Furniture
from objgraph.synthetic.photograph import MEASURED, DarkPlaces, Photograph, dark_places, photograph
from objgraph.synthetic.render import Renderer
from objgraph.synthetic.sensor import SensorConfig, sense_depth, sense_masks

SIZES = {"small": 6, "standard": 24, "full": 100}
"""Objects a category."""
_NUMBERS = {
    "chair": 0, "table": 1, "sofa": 2, "bed": 3, "cabinet": 4, "bookshelf": 5, "bathtub": 6, "trash_bin": 7,
    "display": 8,
}  # fmt: skip
"""In the seeds: never to be changed."""
_TARGET = 1
UP = np.array([0.0, 0.0, 1.0])
UP.flags.writeable = False
"""Of every case's world."""


@dataclass(frozen=True)
class BenchmarkConfig:
    """Which cases; equal configurations give equal cases, and a smaller size the first of a larger one."""

    seed: int = 0
    """Of shapes, rooms, cameras and noise."""
    size: Literal["small", "standard", "full"] = "small"
    """6, 24 or 100 objects a category."""
    objects: int | None = None
    """Any other number of objects a category."""
    categories: tuple[str, ...] = ("chair", "table")
    """Categories of the objects; other than chairs and tables they need `meshes`."""
    spacing: Spacing = "wide"
    """Clean views are 40 to 100 degrees apart about the object, or 5 to 15."""
    difficulty: Difficulty = "clean"
    """Which faults scans have."""
    faults: FaultRanges | None = None
    """Their strengths, in place of the difficulty's."""
    shapes: ShapeSet = "families"
    """Which shapes: the families, or of `meshes` those held out, made by people (`cad`) or by a generator (`everyday`)."""
    meshes: Path | None = None
    """A folder with a subfolder of CAD meshes for each category (y up, front at -z)."""
    sensor: SensorConfig = field(default_factory=SensorConfig)
    """The faults of clean depth and masks."""

    @property
    def count(self) -> int:
        """Objects a category."""
        return SIZES[self.size] if self.objects is None else self.objects

    @property
    def ranges(self) -> FaultRanges | None:
        """Of the faults' strengths; None for clean scans. Raises `DatasetError` for an unknown difficulty."""
        ranges = ranges_of(self.difficulty)
        return ranges if self.faults is None or ranges is None else self.faults


@dataclass(frozen=True)
class Case:
    """One object to be estimated."""

    id: str
    """Unique among all cases of all configurations that differ in more than their size."""
    category: str
    shape: str
    """Of which distinct shape it is: its family and own seed, or its mesh's name."""
    instance: Instance
    """What the scan's masks call it."""
    seed: int
    """The benchmark's."""
    index: int
    """Of the object within its category."""
    spacing: Spacing
    sensor: SensorConfig
    difficulty: Difficulty = "clean"
    faults: Faults | None = None
    """Strengths; None for a clean scan."""
    shapes: ShapeSet = "families"
    mesh: CadShape | None = None
    """Its shape; None for one of the families."""

    def scan(self) -> AnnotatedScan:
        """Render it: the same frames every time. The ground truth is the target's alone.

        Raises:
            DatasetError: the object cannot be seen.
            PriorError: its mesh file cannot be read any more.
        """
        world = self.world()
        cameras = world.scene.cameras[self.spacing]
        # each frame has its own noise, so that the first is the same for either spacing
        noise = world.noise.spawn(VIEWS)
        by_id = {self.instance.id: world.truth}
        places = [gtsam.Pose3(_raised(pose, world.floor)) for pose in cameras]
        taken = list(zip(places, map(str, range(VIEWS)), noise, strict=True))
        if self.faults is None:
            frames = [world.frame(*each) for each in taken]
            return AnnotatedScan(self.id, ListedFrames(frames), (self.instance,), UP, by_id)
        photographs = [world.photograph(*each) for each in taken]
        conditions = {
            **asdict(self.faults),
            # those of one mask with a neighbour have one pushed against them
            "pushed": self.faults.pushed or self.faults.merged,
            "visible": visible_shares(world.scene.room, cameras),
            **{name: [getattr(each, name) for each in photographs] for name in MEASURED},
        }
        frames = [each.frame for each in photographs]
        return AnnotatedScan(self.id, ListedFrames(frames), (self.instance,), UP, by_id, conditions)

    def world(self) -> "World":
        """The room itself, to be seen from anywhere: always the same. Raises as `scan` does."""
        shape, scene, color, noise = self._generator().spawn(4)
        piece = self._piece(shape)
        # where the floor lies is for the estimator to find
        floor = float(shape.uniform(-1, 1))
        drawn = (
            draw_scene(piece, scene)
            if self.faults is None
            else draw_difficult_scene(piece, self.faults, scene)
        )
        target, room = drawn.room.target, drawn.room
        truth = GroundTruth(
            _raised(target.T_world_object, floor), target.scale, piece.mesh.vertices.view(np.ndarray).copy(),
            piece.mesh.faces.view(np.ndarray).copy(), piece.symmetry,
        )  # fmt: skip
        renderer = Renderer([room.target, *room.clutter], list(room.shell), color)
        return World(drawn, floor, truth, self.sensor, renderer, noise, self.faults)

    def views(self, count: int) -> tuple[int, ...]:
        """Indices of the first `count` views among the scan's frames. Raises `DatasetError` beyond 1 to 3."""
        if not 1 <= count <= VIEWS:
            raise DatasetError(f"{self.id}: {count} views asked for; a case has 1 to {VIEWS}")
        return tuple(range(count))

    def _generator(self) -> Generator:
        return np.random.default_rng([self.seed, _NUMBERS[self.category], self.index])

    def _piece(self, rng: Generator) -> Furniture:
        if self.mesh is not None:
            return mesh_furniture(self.category, self.mesh.path, rng, self.mesh.diagonal_m)
        return make_piece(_with_families(self.category), _family(self.category, self.index), rng)


@dataclass(frozen=True)
class World:
    """A case's room with its floor at some height: what a camera sees of it, and where one can be held."""

    scene: Scene
    """As it was drawn, with its floor at zero."""
    floor: float
    truth: GroundTruth
    """Of the target; for evaluation alone."""
    sensor: SensorConfig
    renderer: Renderer
    noise: Generator
    faults: Faults | None = None
    """Of its photographs; None where they have none."""

    def frame(self, T_world_camera: gtsam.Pose3, name: str, rng: Generator) -> Frame:
        """What the sensor makes of a view; the noise is drawn from `rng`."""
        if self.faults is not None:
            return self.photograph(T_world_camera, name, rng).frame
        camera, pose = CameraConfig(), T_world_camera.matrix()
        drawn = _raised(pose, -self.floor)
        view = self.renderer.render(camera_matrix(camera), drawn, camera.width, camera.height)
        depth = sense_depth(view.depth, view.incidence, self.sensor, rng)
        return Frame(
            name, depth, intrinsics(), pose, sense_masks(view.instances, self.sensor, rng), view.color
        )

    def photograph(self, T_world_camera: gtsam.Pose3, name: str, rng: Generator) -> Photograph:
        """A view with the scan's faults, and how wrong it came out."""
        assert self.faults is not None
        drawn = _raised(T_world_camera.matrix(), -self.floor)
        return photograph(
            self.renderer, drawn, self.floor, self._dark, _TARGET, self.faults, self.sensor, name, rng
        )

    @cached_property
    def _dark(self) -> DarkPlaces:
        assert self.faults is not None
        truth = self.truth
        surface = transformed(truth.T_world_object, truth.scale * truth.vertices)[truth.faces]
        return dark_places(surface, self.faults.holes, self.noise)

    def can_hold(self, T_world_camera: gtsam.Pose3) -> bool:
        """Whether a person can hold a camera there: in the room and over no furniture."""
        return can_hold(self.scene.room, T_world_camera.translation()[:2])

    def first_camera(self) -> gtsam.Pose3:
        """T_world_camera of the case's first view, which is the same in either spacing."""
        return gtsam.Pose3(_raised(self.scene.cameras["wide"][0], self.floor))


def synthetic_cases(config: BenchmarkConfig) -> list[Case]:
    """All cases, category by category; nothing is rendered yet.

    Raises:
        DatasetError: no objects are asked for, a category is not one of the benchmark's, or its folder of meshes
            is missing or holds no mesh that can be read.
    """
    if config.count < 1:
        raise DatasetError(f"the benchmark needs at least one object a category, not {config.count}")
    return [case for name in dict.fromkeys(config.categories) for case in _cases(config, _category(name))]


def _cases(config: BenchmarkConfig, category: str) -> list[Case]:
    if config.difficulty != "clean" and config.spacing != "wide":
        raise DatasetError("a spacing of views is for clean scans; with faults it is one of the strengths")
    meshes, ranges = _meshes(config, category), config.ranges
    cases = []
    for index in range(config.count):
        if config.meshes is not None:
            mesh = meshes[index]
            shape = mesh.path.relative_to(config.meshes).as_posix()
        else:
            shape, mesh = f"{_family(category, index)}-{config.seed}-{index}", None
        # a generator of its own, so that the room is not another one with other strengths
        strengths = np.random.SeedSequence(config.seed, spawn_key=(_NUMBERS[category], index, 1))
        faults = None if ranges is None else ranges.draw(np.random.default_rng(strengths))
        cases.append(
            Case(
                f"{category}-s{config.seed}-{index:03d}{_ending(config, shape)}", category, shape,
                Instance(_TARGET, category), config.seed, index, config.spacing, config.sensor, config.difficulty,
                faults, config.shapes, mesh,
            )
        )  # fmt: skip
    return cases


def _raised(T_room_any: Pose, floor: float) -> Pose:
    """The pose in the world, whose origin does not lie on the room's floor."""
    T_world_any = T_room_any.copy()
    T_world_any[2, 3] += floor
    return T_world_any


def _category(name: str) -> str:
    if name in _NUMBERS:
        return name
    raise DatasetError(f"category {name!r} is not in the synthetic benchmark: it has {', '.join(_NUMBERS)}")


def _with_families(category: str) -> Category:
    for known in get_args(Category):
        if category == known:
            return known
    raise DatasetError(
        f"the benchmark's families are of {' and '.join(FAMILIES)}: of category {category!r} give a folder of meshes (--meshes)"
    )


def _family(category: str, index: int) -> str:
    families = FAMILIES[_with_families(category)]
    return families[index % len(families)]


def _meshes(config: BenchmarkConfig, category: str) -> list[CadShape]:
    if config.meshes is None:
        _with_families(category)
        if config.shapes != "families":
            raise DatasetError(f"shapes '{config.shapes}' are a folder's: give one (--meshes)")
        return []
    # a generator of its own: that of no object
    order = np.random.SeedSequence(config.seed, spawn_key=(_NUMBERS[category],))
    chosen = np.random.default_rng(order)
    return choose_shapes(config.meshes, category, config.shapes, config.count, chosen)


def _ending(config: BenchmarkConfig, shape: str) -> str:
    """What of the configuration an id must say beside the seed: all but the size, where it is not the default."""
    parts = [config.spacing] if config.spacing != "wide" else []
    if config.difficulty != "clean":
        parts.append(config.difficulty)
    if config.faults is not None:
        parts.append(f"faults.{_digest(asdict(config.faults))}")
    if config.meshes is not None:
        parts.append(f"{config.meshes.name}.{_digest((str(config.meshes.resolve()), shape))}")
    if config.sensor != SensorConfig():
        parts.append(f"sensor.{_digest(asdict(config.sensor))}")
    return "".join(f"-{part}" for part in parts)


def _digest(value: object) -> str:
    return hashlib.sha256(repr(value).encode()).hexdigest()[:6]
