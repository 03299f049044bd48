"""Objects added to somebody's pose graph: drifting odometry, no loop closures but the furniture itself.

    python examples/03_objects_in_your_graph.py --out out/slam

A camera walks twice about a furnished room. The pose graph is plain GTSAM: a prior on the first camera and odometry
that drifts by 2 % of the distance and 1 degree a metre. Then each object is one more variable of that same graph, seen
from the camera's keys, and ties the second lap to the first. (`python -m objgraph.bench.slam` measures it over many draws.)
"""

import json
from dataclasses import dataclass, replace
from pathlib import Path

import gtsam
import matplotlib.pyplot as plt
import numpy as np
import tyro
from gtsam.symbol_shorthand import X
from rich.progress import track

import objgraph

FEW = objgraph.SamplingConfig(points=100, hits=40, free=40)
"""Of every view; the graph counts independent measurements, not pixels."""


@dataclass
class Arguments:
    out: Path
    """Where the picture, the trajectories and metrics.json go."""
    frames: int = 40
    """Of all laps."""
    laps: float = 2.0
    """Times that the camera walks about the room."""
    objects: int = 6
    """Of the room's six, how many to use."""
    seed: int = 0
    """Of the odometry's noise."""


def pose_graph(truth: list[gtsam.Pose3], seed: int) -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values]:
    """What a SLAM engineer has already: X(0), X(1), ... and odometry between them."""
    noise = objgraph.slam.OdometryNoise()
    motions = objgraph.slam.drifting_motions(truth, noise, np.random.default_rng(seed))
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    graph.push_back(gtsam.PriorFactorPose3(X(0), truth[0], gtsam.noiseModel.Isotropic.Sigma(6, 1e-4)))
    for k, motion in enumerate(motions):
        graph.push_back(gtsam.BetweenFactorPose3(X(k), X(k + 1), motion, noise.model(motion)))
    for k, pose in enumerate(objgraph.slam.dead_reckoning(truth[0], motions)):
        values.insert(X(k), pose)
    return graph, values


def trajectory(poses: list[gtsam.Pose3]) -> objgraph.datasets.Trajectory:
    times = np.arange(len(poses), dtype=float)
    return objgraph.datasets.Trajectory(times, np.stack([pose.matrix() for pose in poses]))


def main(arguments: Arguments) -> None:
    scan = objgraph.load_scan("sample", Path("out"), frames=arguments.frames, laps=arguments.laps)
    frames = [scan.frames[k] for k in range(len(scan.frames))]
    truth = [gtsam.Pose3(frame.T_world_camera) for frame in frames]
    graph, values = pose_graph(truth, arguments.seed)
    odometry = [values.atPose3(X(k)) for k in range(len(frames))]

    # From here on the true poses are forgotten: every frame is where odometry has it.
    frames = [replace(f, T_world_camera=p.matrix()) for f, p in zip(frames, odometry, strict=True)]
    objects = objgraph.ObjectGraph(graph, values, up_world=scan.up_world, floor=0.0)
    for instance in track(scan.instances[: arguments.objects], "adding objects"):
        seen = {}
        for k, frame in enumerate(frames):
            try:
                seen[k] = objgraph.observe(frame, instance.id, FEW, seed=k)
            except objgraph.ObjectGraphError:
                continue  # out of sight, or too little of it
        if not seen:
            continue
        # It starts from its first views, whose cameras are near each other, and is observed in all.
        near = [k for k in seen if k < min(seen) + 6][::2]
        chair_or_table = objects.add_object(instance.category, [seen[k] for k in near])
        for k, view in seen.items():
            objects.observe(chair_or_table, view, camera=X(k))
    objects.optimize()  # or objects.refresh() and your own optimiser

    paths = {
        "truth": trajectory(truth),
        "odometry": trajectory(odometry),
        "with_objects": trajectory([values.atPose3(X(k)) for k in range(len(truth))]),
    }
    arguments.out.mkdir(parents=True, exist_ok=True)
    error = objgraph.datasets.absolute_trajectory_error
    metrics = {f"ate_{name}_m": error(paths[name], paths["truth"]) for name in ("odometry", "with_objects")}
    (arguments.out / "metrics.json").write_text(json.dumps(metrics, indent=1) + "\n")
    print(metrics)
    figure, axis = plt.subplots(figsize=(7, 7))
    for (name, path), color in zip(paths.items(), ("0.6", "tab:red", "tab:blue"), strict=True):
        objgraph.datasets.write_tum(arguments.out / f"{name}.txt", path)
        axis.plot(*path.positions[:, :2].T, ".-", color=color, label=name.replace("_", " "))
    axis.set_title("absolute trajectory error: " + ", ".join(f"{v:.3f} m" for v in metrics.values()))
    axis.set(aspect="equal", xlabel="x, m", ylabel="y, m")
    axis.legend()
    figure.savefig(arguments.out / "trajectories.png", dpi=110, bbox_inches="tight")


if __name__ == "__main__":
    main(tyro.cli(Arguments))
