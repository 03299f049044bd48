"""How well objects hold cameras: drifting odometry, no loop closures but the furniture itself, over many draws of noise.

    python -m objgraph.bench.slam --out out/slam --seeds 20 --jobs 2
    python -m objgraph.bench.slam --out out/kitchen --dataset sevenscenes --root DIR --stride 4 --reference depth

A camera walks twice about a furnished room. The pose graph is plain GTSAM: a prior on the first camera and odometry
that drifts by 2 % of the distance and 1 degree a metre. Then each object is one more variable of that same graph, seen
from the camera's keys, and ties the second lap to the first. The same with a scan of your own: its poses are the truth,
or those that its depth images have among themselves, and only the odometry that is drawn from them reaches the graph.
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Literal

import gtsam
import matplotlib.pyplot as plt
import numpy as np
import tyro
from gtsam.symbol_shorthand import X
from rich.progress import Progress, track
from scipy.stats import chi2

from objgraph.atomic import write_file
from objgraph.bench.dense_reference import dense_reference
from objgraph.datasets.registry import load_scan
from objgraph.datasets.trajectory import Trajectory, absolute_trajectory_error, read_tum, write_tum
from objgraph.errors import InitialisationError, ObservationError, ProcessError
from objgraph.graph.object_graph import ObjectGraph
from objgraph.maps.pipeline import scene_floor
from objgraph.observation.frames import Frame, FrameSource, Scan
from objgraph.observation.sampling import SamplingConfig, observe, rigid_pose
from objgraph.slam.odometry import OdometryNoise, dead_reckoning, drifting_motions
from objgraph.work import Workers, spread

FEW = SamplingConfig(
    points=100, hits=40, free=40
)  # of every view; the graph counts patches of surface, not pixels


@dataclass
class Arguments:
    out: Path
    """Where the picture, the trajectories and metrics.json go."""
    seeds: int = 1
    """Draws of the odometry's noise; those that `out` has already are not run again."""
    jobs: int = 1
    """Draws at the same time."""
    frames: int = 40
    """Of all laps."""
    laps: float = 2.0
    """Times that the camera walks about the room."""
    objects: int = 6
    """Of the scan's objects, how many to use; the room has six."""
    dataset: str | None = None
    """A scan in place of the room: its data set, named as `objgraph map` does."""
    root: Path | None = None
    """The data set's folder."""
    scene: str | None = None
    """The scan, where the folder has several."""
    stride: int = 1
    """Of the scan, every how manyth frame."""
    reference: Literal["given", "depth"] = "given"
    """What counts as the truth: the scan's own poses, or those by registration of whole depth images with each other."""


class OdometryFrames(FrameSource):
    """Some of a scan's frames, with the poses that odometry gives them: the true ones are for the evaluation."""

    def __init__(self, frames: FrameSource, indices: Sequence[int], poses: Sequence[gtsam.Pose3]) -> None:
        self.frames, self.indices, self.poses = frames, indices, poses

    def __len__(self) -> int:
        return len(self.indices)

    def __getitem__(self, index: int) -> Frame:
        return replace(self.frames[self.indices[index]], T_world_camera=self.poses[index].matrix())


def pose_graph(
    start: gtsam.Pose3, motions: list[gtsam.Pose3], noise: OdometryNoise
) -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values]:
    """What a SLAM engineer has already: X(0), X(1), ... and odometry between them."""
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    graph.push_back(gtsam.PriorFactorPose3(X(0), start, gtsam.noiseModel.Isotropic.Sigma(6, 1e-4)))
    for k, motion in enumerate(motions):
        graph.push_back(gtsam.BetweenFactorPose3(X(k), X(k + 1), motion, noise.model(motion)))
    for k, pose in enumerate(dead_reckoning(start, motions)):
        values.insert(X(k), pose)
    return graph, values


def add_objects(
    scan: Scan, count: int, graph: gtsam.NonlinearFactorGraph, values: gtsam.Values
) -> ObjectGraph:
    """Each object starts from its best views within a few frames of each other, and is observed in all."""
    few = range(min(3, len(scan.frames)))  # later ones have drifted off the floor's plane
    beginning = OdometryFrames(scan.frames, few, [values.atPose3(X(k)) for k in few])
    floor = scene_floor(replace(scan, frames=beginning))
    objects = ObjectGraph(graph, values, up_world=scan.up_world, floor=floor)
    instances = scan.instances[:count]
    views = {instance.id: {} for instance in instances}
    for k in track(range(len(scan.frames)), "looking at frames"):
        frame = scan.frames[k]
        for instance in instances:
            try:
                views[instance.id][k] = observe(frame, instance.id, FEW, seed=k)
            except ObservationError:
                continue  # out of sight, or too little of it
    for instance in track(instances, "adding objects"):
        seen = views[instance.id]
        near = [k for k in sorted(seen) if k < min(seen) + 6][::2]
        try:
            handle = objects.add_object(instance.category, [seen[k] for k in near])
        except InitialisationError as error:
            print(f"object {instance.id} is left out: {error}")
            continue
        for k, view in seen.items():
            objects.observe(handle, view, camera=X(k))
    return objects


def reference(arguments: Arguments, scan: Scan) -> tuple[Trajectory, dict[str, float]]:
    """What odometry is drawn from and estimates are compared with, and how well it is known; kept in `out`."""
    indices = range(0, len(scan.frames), arguments.stride)
    given = [rigid_pose(scan.frames[i], "the truth").matrix() for i in indices]
    trajectory = Trajectory(np.arange(len(indices), dtype=float), np.stack(given))
    path, before = arguments.out / "reference.txt", _document(arguments)
    if arguments.reference == "given":
        return trajectory, {}
    if path.exists() and "reference" in before:
        return read_tum(path), before["reference"]
    frames = [scan.frames[i] for i in track(indices, "reading frames")]
    with Progress() as bar:
        task = bar.add_task("registering frames", total=len(frames))
        found = dense_reference(frames, lambda done, _: bar.update(task, completed=done))
    dense = Trajectory(trajectory.timestamps, found.T_world_camera)
    write_tum(path, dense)
    facts = {
        "pairs": found.pairs,
        "spread_m": found.spread_m,
        "given_spread_m": found.given_spread_m,
        "ate_given_m": absolute_trajectory_error(trajectory, dense),
    }
    return dense, facts


def run(arguments: Arguments, seed: int, true: Trajectory) -> tuple[dict[str, float], dict[str, Trajectory]]:
    scan = scan_of(arguments)
    indices = range(0, len(scan.frames), arguments.stride)
    times = true.timestamps
    truth = [gtsam.Pose3(gtsam.Rot3.ClosestTo(T[:3, :3]), T[:3, 3]) for T in true.T_world_camera]
    noise = OdometryNoise()
    graph, values = pose_graph(truth[0], drifting_motions(truth, noise, np.random.default_rng(seed)), noise)
    odometry = [values.atPose3(X(k)) for k in range(len(truth))]
    before = Trajectory(times, np.stack([pose.matrix() for pose in odometry]))
    scan = replace(scan, frames=OdometryFrames(scan.frames, indices, odometry))
    objects = add_objects(scan, arguments.objects, graph, values)
    objects.optimize()
    after = Trajectory(times, np.stack([values.atPose3(X(k)).matrix() for k in range(len(truth))]))
    marginals = gtsam.Marginals(graph, values)
    errors = [values.atPose3(X(k)).localCoordinates(pose) for k, pose in enumerate(truth)]
    squared = np.array(
        [e @ np.linalg.solve(marginals.marginalCovariance(X(k)), e) for k, e in enumerate(errors)][1:]
    )
    metrics = {
        "ate_odometry_m": absolute_trajectory_error(before, true),
        "ate_with_objects_m": absolute_trajectory_error(after, true),
        **{f"coverage_{p}": float(np.mean(squared < chi2.ppf(p / 100, 6))) for p in (50, 90, 95)},
        "nees_per_dof": float(np.mean(squared)) / 6,
    }
    return metrics, {"truth": true, "odometry": before, "with_objects": after}


def picture(paths: dict[str, Trajectory], metrics: dict[str, float], path: Path) -> None:
    figure, axis = plt.subplots(figsize=(7, 7))
    for (name, trajectory), color in zip(paths.items(), ("0.6", "tab:red", "tab:blue"), strict=True):
        axis.plot(*trajectory.positions[:, :2].T, ".-", color=color, label=name.replace("_", " "))
    odometry, objects = metrics["ate_odometry_m"], metrics["ate_with_objects_m"]
    axis.set_title(f"absolute trajectory error: odometry {odometry:.3f} m, with objects {objects:.3f} m")
    axis.set_aspect("equal")
    axis.set_xlabel("x, m")
    axis.set_ylabel("y, m")
    axis.legend()
    figure.savefig(path, dpi=110, bbox_inches="tight")
    plt.close(figure)


def scan_of(arguments: Arguments) -> Scan:
    if arguments.dataset is not None:
        return load_scan(arguments.dataset, arguments.root or Path(), arguments.scene)
    return load_scan("sample", Path("out"), frames=arguments.frames, laps=arguments.laps)


def main(arguments: Arguments) -> None:
    scan = scan_of(arguments)  # what is wrong with it is said here, and a room that is missing is made once
    arguments.out.mkdir(parents=True, exist_ok=True)
    rows = finished(arguments)
    missing = [seed for seed in range(arguments.seeds) if seed not in rows]
    if not missing:
        print(means(rows))
        return
    true, facts = reference(arguments, scan)
    for place, done in spread(
        [partial(run, arguments, seed, true) for seed in missing], Workers(arguments.jobs)
    ):
        seed = missing[place]
        if isinstance(done, ProcessError):
            print(f"seed {seed} is left out: {done}")
            continue
        rows[seed], paths = done
        print(seed, rows[seed], flush=True)
        for name, trajectory in paths.items():
            write_tum(arguments.out / f"{name}_{seed}.txt", trajectory)
        if seed == 0:
            picture(paths, rows[seed], arguments.out / "trajectories.png")
        write_metrics(arguments, rows, facts)
    print(means(rows))


def settings(arguments: Arguments) -> dict[str, str]:
    """What the rows depend on."""
    return {
        name: str(value) for name, value in vars(arguments).items() if name not in ("out", "seeds", "jobs")
    }


def finished(arguments: Arguments) -> dict[int, dict[str, float]]:
    """The seeds that a run before has done with the same settings: twenty take an hour or more."""
    return {int(row.pop("seed")): row for row in _document(arguments).get("seeds", [])}


def means(rows: dict[int, dict[str, float]]) -> dict[str, float]:
    """Over the seeds that are done."""
    return {name: float(np.mean([row[name] for row in rows.values()])) for name in next(iter(rows.values()))}


def write_metrics(arguments: Arguments, rows: dict[int, dict[str, float]], facts: dict[str, float]) -> None:
    """metrics.json: means, each seed, and what is known of the reference."""
    each = [{"seed": seed, **rows[seed]} for seed in sorted(rows)]
    known = {"reference": facts} if facts else {}
    document = {**means(rows), **known, "settings": settings(arguments), "seeds": each}
    write_file(arguments.out / "metrics.json", (json.dumps(document, indent=1) + "\n").encode())


def _document(arguments: Arguments) -> dict[str, Any]:
    """What a run before has written with the same settings."""
    path = arguments.out / "metrics.json"
    before = json.loads(path.read_text()) if path.exists() else {}
    return before if before.get("settings") == settings(arguments) else {}


if __name__ == "__main__":
    main(tyro.cli(Arguments))
