"""How near a map that grew frame by frame is to the solution of all its factors at once.

    python -m tests.benchmarks.incremental_vs_batch [frames] [objects] [seed] [--prior rounded|boxes|chair]

Chairs in a ring, a camera that goes round it twice and drifts. The chairs are the prior's own shapes: of the toy prior with
rounded boxes, of the toy prior itself (a union of boxes, whose distance has a kink wherever another face is the nearest), or
of the shipped one. The batch solution is Levenberg-Marquardt on the nonlinear factors of `IncrementalObjectGraph.batch()`,
from where the updates left the map, with the samples that `optimize` drew. Compared are all tangent dimensions of all objects
and cameras, in the batch solution's standard deviations: after `update` alone, and after `optimize`. What drawing the
samples once more does to the batch solution itself is printed beside it.
"""

import sys
import time
from dataclasses import dataclass, replace
from functools import cache, partial
from typing import NamedTuple

import gtsam
import numpy as np
import torch
import trimesh

from factors.base import Annealing
from factors.sdf_decoder import SdfDecoder
from factors.state import ObjectState
from objgraph.graph.initialise import InitialisationConfig
from objgraph.graph.solve import LevenbergMarquardtConfig, Problem, SolverConfig, minimize
from objgraph.observation.frames import Instance
from objgraph.observation.sampling import SamplingConfig
from objgraph.priors.mesh import extract_mesh
from objgraph.priors.registry import load_prior
from objgraph.priors.shape_prior import ShapePrior
from objgraph.slam.incremental.local import polish
from objgraph.slam.incremental.object_graph import IncrementalObjectGraph
from objgraph.slam.odometry import OdometryNoise, dead_reckoning, drifting_motions
from tests.objgraph.slam.test_incremental import QUICK, UP
from tests.toys import ToyDecoder, look_at, toy_picture, toy_prior

LAPS = 2
SEEN = 2
"""Detections a frame, at most: the largest."""
CONFIG = replace(
    QUICK,
    sampling=SamplingConfig(points=50, hits=20, free=20),
    initialisation=InitialisationConfig(headings=4, guesses=1, points=60, rays=60, shortlist=1, keep=1),
    start=SolverConfig(rounds=3),
    tracking=SolverConfig(slopes=(120.0, 400.0), rounds=2, inner=LevenbergMarquardtConfig(iterations=4)),
)
"""For speed."""
LEARNT = replace(
    CONFIG, sampling=SamplingConfig(points=100, hits=60, free=60), initialisation=InitialisationConfig()
)
"""A learnt prior's shapes are told apart by more points."""
EXACTLY = LevenbergMarquardtConfig(iterations=8, relative_tolerance=1e-6)


def prior_of(kind: str) -> ShapePrior:
    return load_prior(kind) if kind == "chair" else toy_prior(rounded=kind == "rounded")


def chairs_of(prior: ShapePrior, count: int, radius: float, rng: np.random.Generator) -> list[ObjectState]:
    """Shapes that the prior knows, in a ring on the floor."""
    states = []
    for a in np.linspace(0, 2 * np.pi, count, endpoint=False):
        rotation = gtsam.Rot3.Rz(rng.uniform(-3, 3)).compose(gtsam.Rot3.Rx(np.pi / 2))
        if isinstance(prior.decoder, ToyDecoder):
            code = 0.5 * rng.normal(size=prior.decoder.code_length)
        else:
            code = np.array(prior.starts[1 + rng.integers(len(prior.starts) - 1)], dtype=float)
        log_scale = np.log(prior.size_mean) + 0.03 * rng.normal(size=3)
        height = -shape(prior.decoder, code.tobytes()).bounds[0, 1] * np.exp(log_scale[1])
        place = np.array([radius * np.cos(a), radius * np.sin(a), height])
        states.append(ObjectState(gtsam.Pose3(rotation, place), log_scale, code))
    return states


@cache
def shape(decoder: SdfDecoder, code: bytes) -> trimesh.Trimesh:
    return extract_mesh(decoder, np.frombuffer(code), resolution=48)


def ring(frames: int, count: int, seed: int, prior: ShapePrior) -> IncrementalObjectGraph:
    """The map after all frames' updates."""
    rng = np.random.default_rng(seed)
    radius = max(1.2, 1.4 * count / (2 * np.pi))
    chairs = chairs_of(prior, count, radius, rng)
    draw = partial(toy_picture, mesh_of=lambda code: shape(prior.decoder, code.tobytes()))
    truth = []
    for a in np.linspace(0, LAPS * 2 * np.pi, frames):
        out = (radius + 2.2) * np.array([np.cos(a), np.sin(a)])
        truth.append(
            gtsam.Pose3(
                look_at(np.r_[out, 1.3], np.r_[radius * np.cos(a + 0.1), radius * np.sin(a + 0.1), 0.4])
            )
        )
    odometry = dead_reckoning(truth[0], drifting_motions(truth, OdometryNoise(), rng))
    config = CONFIG if isinstance(prior.decoder, ToyDecoder) else LEARNT
    objects = IncrementalObjectGraph(UP, floor=0.0, config=config, find_prior=lambda _: prior)
    for k, (pose, drifted) in enumerate(zip(truth, odometry, strict=True)):
        frame = replace(draw(chairs, pose.matrix(), str(k), seed=k), T_world_camera=drifted.matrix())
        ids, pixels = np.unique(frame.instances[frame.instances > 0], return_counts=True)
        report = objects.update(frame, [Instance(int(i), "chair") for i in ids[np.argsort(-pixels)[:SEEN]]])
        if "-v" in sys.argv:
            print(frame.name, len(report.seen), report.entered, report.pending, flush=True)
    return objects


@dataclass(frozen=True)
class Solution:
    """Means, and the covariance of each variable."""

    values: gtsam.Values
    sigma: dict[int, np.ndarray]


def incremental(objects: IncrementalObjectGraph) -> Solution:
    """The map as it is."""
    values, smoother = objects.batch().values, objects.system.smoother
    return Solution(values, {key: sigmas(smoother.covariance([key])) for key in values.keys()})  # noqa: SIM118


def sigmas(covariance: np.ndarray) -> np.ndarray:
    return np.sqrt(np.diag(covariance))


def batch(
    objects: IncrementalObjectGraph, start: gtsam.Values, redraw: bool = False, by_gtsam: bool = False
) -> Solution:
    """All factors at once, by default with the samples that they have; `by_gtsam`: with GTSAM's own optimiser."""
    graph = objects.batch()
    factors = [factor for handle in graph.objects for factor in handle.factors]
    if redraw:
        for factor in factors:
            factor.refresh(start, Annealing(objects.system.slope))
    problem = Problem("batch", graph.graph, start, factors)
    if by_gtsam:
        params = gtsam.LevenbergMarquardtParams()
        params.setRelativeErrorTol(1e-8)
        problem.values = gtsam.LevenbergMarquardtOptimizer(graph.graph, start, params).optimize()
    else:
        minimize(problem, EXACTLY)
        polish(problem)
    keys = list(problem.values.keys())
    marginals = gtsam.Marginals(problem.graph, problem.values)
    return Solution(problem.values, {key: sigmas(marginals.marginalCovariance(key)) for key in keys})


class Apart(NamedTuple):
    """What lies between two solutions, over all tangent dimensions of objects and cameras."""

    mean: float
    """Root mean square difference of the means, in standard deviations."""
    mean_largest: float
    sigma: float
    """Root mean square of the relative differences of the standard deviations."""
    sigma_largest: float


def apart(one: Solution, other: Solution) -> Apart:
    step = other.values.localCoordinates(one.values)
    mean = np.concatenate([step.at(key) / sigma for key, sigma in other.sigma.items()])
    sigma = np.concatenate([one.sigma[key] / sigma for key, sigma in other.sigma.items()]) - 1
    return Apart(rms(mean), float(np.abs(mean).max()), rms(sigma), float(np.abs(sigma).max()))


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def main(frames: int, count: int, seed: int, prior: ShapePrior) -> None:
    torch.set_num_threads(1)
    start = time.process_time()
    objects = ring(frames, count, seed, prior)
    print(
        f"{len(objects.objects)} objects, {len(objects.cameras)} frames: {time.process_time() - start:.0f} s",
        flush=True,
    )
    grown = incremental(objects)
    objects.optimize()
    print(f"optimised: {time.process_time() - start:.0f} s", flush=True)
    whole = batch(objects, grown.values)
    report("after update", grown, whole)
    report("after optimize", incremental(objects), whole)
    report("batch by GTSAM", batch(objects, grown.values, by_gtsam=True), whole)
    report("batch, drawn anew", batch(objects, gtsam.Values(whole.values), redraw=True), whole)


def report(name: str, solution: Solution, whole: Solution) -> None:
    found = apart(solution, whole)
    print(
        f"{name:18} means: rms {found.mean:.3f} sigma, largest {found.mean_largest:.2f}; "
        f"sigmas: rms {found.sigma:.1%}, largest {found.sigma_largest:.1%}",
        flush=True,
    )


if __name__ == "__main__":
    kind = sys.argv[sys.argv.index("--prior") + 1] if "--prior" in sys.argv else "rounded"
    given = [int(word) for word in sys.argv[1:] if word.isdigit()]
    frames, count, seed = given + [100, 20, 1000][len(given) :]
    main(frames, count, seed, prior_of(kind))
