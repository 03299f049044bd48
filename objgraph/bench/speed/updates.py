"""What an update of the incremental map takes as the map grows.

A camera goes along a row of crates, and at the end it sees the last ones again and again: those updates are timed. The row
repeats itself, so that maps of any size (in tens) end alike, and a crate's picture and its own solution are made once: the
map is built from these, since it is not building that is measured.
"""

import time
from dataclasses import replace

import gtsam
import numpy as np

from factors.state import ObjectKeys, ObjectState
from objgraph.bench.speed import crates
from objgraph.bench.speed.crates import CRATE, PERIOD, UP
from objgraph.bench.speed.figure import Figure, ratio
from objgraph.errors import EvaluationError
from objgraph.graph.builder import ObjectBuilder
from objgraph.graph.solve import solve
from objgraph.observation.frames import Instance
from objgraph.observation.sampling import ObjectView, observe
from objgraph.priors.fallback import fallback_prior
from objgraph.slam.incremental.config import IncrementalConfig
from objgraph.slam.incremental.object_graph import IncrementalObjectGraph
from objgraph.slam.incremental.tracked import TrackedObject, linearize
from objgraph.slam.odometry import OdometryNoise
from objgraph.work import threads

CONFIG = IncrementalConfig(
    graph=crates.GRAPH,
    sampling=crates.SAMPLING,
    initialisation=crates.INITIALISATION,
    odometry=OdometryNoise(translation=0.002, rotation=2e-4),
)
_FIX = gtsam.noiseModel.Diagonal.Sigmas(np.repeat([2e-3, 0.02], 3))
"""Of each camera's place, told by something else (a factor of the caller's): a chain of a thousand bends, and then nothing is
recognised."""
_NEAR = 1.6
"""Metres along the row within which the camera sees a crate."""


def growing_map(few: int, many: int, repeats: int) -> Figure:
    """An update's time with many crates over that with few; raises EvaluationError where too few could be timed."""
    with threads(1):
        solved = solved_crates()
        spent = {count: updates(map_of(count, solved), repeats) for count in (few, many)}
    least = min(map(len, spent.values()))
    if least < max(repeats // 2, 1):
        raise EvaluationError(
            f"only {least} of {repeats} updates saw what the map has: they cannot be compared"
        )
    what = (
        f"processor time of an update, {many} over {few} crates, of which the camera sees three; "
        f"{least} updates each; {1e3 * np.median(spent[few]):.0f} ms with {few}"
    )
    return ratio("update_1000_over_10", spent[many][:least], spent[few][:least], 1.5, what)


def solved_crates() -> list[tuple[ObjectState, ObjectView]]:
    """For each crate of a period its own solution from the one view of it."""
    prior, found = fallback_prior(CRATE), []
    for x in range(-PERIOD, 0):
        view = observe(crates.picture(float(x), [x], str(x), seed=x + PERIOD), 1, CONFIG.sampling)
        log_scale = np.log(
            crates.extents(x) * np.sqrt(3)
        )  # a superquadric's edges are a cube's of diagonal 1
        start = ObjectState(crates.pose(x), log_scale, prior.code_mean)
        single = ObjectBuilder(CONFIG.graph, UP).alone(prior, start, [view])
        solve([single], CONFIG.start)
        found.append((single.state, view))
    return found


def map_of(count: int, solved: list[tuple[ObjectState, ObjectView]]) -> IncrementalObjectGraph:
    """A map of so many crates, each seen by the camera that passed it."""
    prior = fallback_prior(CRATE)
    objects = IncrementalObjectGraph(UP, floor=None, config=CONFIG, find_prior=lambda _: prior)
    system = objects.system
    models: dict[int, list[gtsam.LinearContainerFactor]] = {}
    for x in range(-count, 0):
        place = crates.camera(float(x))
        nothing = replace(crates.picture(0.0, [], str(x)), T_world_camera=place.matrix())
        fixed = gtsam.PriorFactorPose3(objects.next_camera, place, _FIX)
        report = objects.update(nothing, [], factors=[fixed])
        state, view = solved[x % PERIOD]
        T_camera_object = crates.camera(float(x % PERIOD - PERIOD)).between(state.T_world_object)
        here = replace(state, T_world_object=objects.pose(report.camera).compose(T_camera_object))
        entry = TrackedObject(f"{CRATE} {x}", ObjectKeys.numbered(count + x), prior)
        at = system.estimates([], [report.camera])
        here.insert(at, entry.keys)
        own = [*system.observations(entry, [(report.camera, view)]), *system.unseen(entry)]
        if x % PERIOD not in models:
            models[x % PERIOD] = linearize(own, at, system.slope)
        quadratics = [
            _about(model, each.keys, at) for each, model in zip(own, models[x % PERIOD], strict=True)
        ]
        system.enter(entry, ObjectBuilder(CONFIG.graph, UP).priors(prior, entry.keys), own, quadratics, at)
        objects.places.note([entry])
    return objects


def _about(
    quadratic: gtsam.LinearContainerFactor, keys: list[int], at: gtsam.Values
) -> gtsam.LinearContainerFactor:
    """The same quadratic on other variables, about where those are."""
    other = quadratic.rekey(gtsam.KeyVector(keys))
    assert isinstance(other, gtsam.LinearContainerFactor)
    return gtsam.LinearContainerFactor(other.factor(), at.extract(gtsam.KeyVector(keys)))


def updates(objects: IncrementalObjectGraph, repeats: int) -> list[float]:
    """Processor seconds of each update in which the map recognises all that the camera sees."""
    spent = []
    for k in range(repeats):
        x = -1.5 - 0.02 * k
        near = [each for each in range(-PERIOD - 2, 0) if abs(each - x) < _NEAR]
        frame = crates.picture(x, near, f"again {k}", seed=10_000 + k)
        detected = [Instance(1 + j, CRATE) for j in range(len(near))]
        begun = time.process_time()
        report = objects.update(frame, detected)
        if not report.entered and not report.pending:
            spent.append(time.process_time() - begun)
    return spent
