"""Marginals beside the spread over re-drawn sensor noise: python -m tests.benchmarks.noise_redraw OBJECTS DRAWS [SEED]

Objects of the synthetic benchmark, seen by the cameras of their own case: only the sensor's noise and the draw of pixels
change from estimate to estimate, all from the starts of the first. What the marginals say beyond that spread is for what
all draws share: the prior's misfit, of which noise knows nothing. Standard deviations are quadratic means over the objects.
"""

import sys

import gtsam
import numpy as np

from objgraph.bench.worlds.cases import UP, BenchmarkConfig, Case, synthetic_cases
from objgraph.estimate.graph import GraphEstimator
from objgraph.estimate.task import EstimationTask
from objgraph.graph.builder import GraphConfig, ObjectBuilder
from objgraph.graph.initialise import first_states
from objgraph.observation.sampling import ObjectView, observe
from objgraph.priors.registry import prior_for

BLOCKS = {"rotation, deg": slice(0, 3), "translation, cm": slice(3, 6), "log-scale, %": slice(6, 9)}
UNITS = {"rotation, deg": np.degrees(1.0), "translation, cm": 100.0, "log-scale, %": 100.0}


def views_of(case: Case, count: int, draw: int) -> list[ObjectView]:
    """What the case's cameras see with other noise."""
    world, scan = case.world(), case.scan()
    rng = np.random.default_rng([draw, case.index])
    cameras = [gtsam.Pose3(scan.frames[k].T_world_camera) for k in case.views(count)]
    frames = [world.frame(camera, str(k), rng) for k, camera in enumerate(cameras)]
    return [observe(frame, case.instance.id, seed=1000 * draw + k) for k, frame in enumerate(frames)]


def deviations(case: Case, views: int, draws: int) -> tuple[np.ndarray, np.ndarray]:
    """Mean variances by the marginals, and variances over the draws, of pose and log-scale."""
    prior, floor = prior_for(case.category), case.world().floor
    several = [views_of(case, views, draw) for draw in range(draws)]
    starts = first_states(prior, several[0], ObjectBuilder(GraphConfig(), UP, floor)).states
    tasks = [EstimationTask(case.id, prior, starts[:1], tuple(each), UP, floor) for each in several]
    found = [each for each in GraphEstimator().estimate(tasks) if not isinstance(each, Exception)]
    middle = found[0].state
    errors = [
        np.r_[
            middle.T_world_object.localCoordinates(each.state.T_world_object),
            each.state.log_scale - middle.log_scale,
        ]
        for each in found
    ]
    known = [np.diag(each.covariance.rigid) for each in found if each.covariance is not None]
    return np.mean(known, axis=0), np.var(errors, axis=0, ddof=1)


def main(objects: int, draws: int, seed: int) -> None:
    print(f"{'':6} {'views':>5}  " + "".join(f"{block + ': marginals, noise':>38}" for block in BLOCKS))
    for category in ("chair", "table"):
        for views in (1, 3):
            cases = synthetic_cases(BenchmarkConfig(seed=seed, objects=objects, categories=(category,)))
            known, spread = np.mean([deviations(case, views, draws) for case in cases], axis=0)
            row = ""
            for block, part in BLOCKS.items():
                a, b = (UNITS[block] * np.sqrt(each[part].mean()) for each in (known, spread))
                row += f"{a:17.2f} {b:6.2f} ({a / b:9.1f} x)"
            print(f"{category:6} {views:5}  {row}", flush=True)


if __name__ == "__main__":
    given = [int(argument) for argument in sys.argv[1:]]
    main(*given, *(3, 8, 1000)[len(given) :])
