"""A map that grows frame by frame: drifting odometry and masks go in, objects and cameras come out.

    python examples/04_incremental.py --out out/incremental

A camera walks twice about a furnished room. No mask says which object of the map it is: that is for the association to
find. Whatever was decided is printed with its reason.
"""

import json
import time
from dataclasses import dataclass, replace
from pathlib import Path

import gtsam
import matplotlib.pyplot as plt
import numpy as np
import tyro

import objgraph


@dataclass
class Arguments:
    out: Path
    """Where the picture, the trajectories and metrics.json go."""
    frames: int = 48
    """Of all laps."""
    laps: float = 2.0
    """Times that the camera walks about the room."""
    objects: int = 6
    """Of the room's six, how many to use."""
    seed: int = 0
    """Of the odometry's noise."""
    rerun: Path | None = None
    """A recording of it for the viewer, FILE.rrd: needs `pip install -e '.[view]'`."""


def detections(frame: objgraph.Frame, instances, rng: np.random.Generator) -> list[objgraph.Instance]:
    """What a detector would say of this frame: masks and categories, in an order that tells nothing."""
    seen = [each for each in instances if np.count_nonzero(frame.instances == each.id) >= 600]
    return [seen[i] for i in rng.permutation(len(seen))]


def draw_objects(objects: objgraph.IncrementalObjectGraph, axis) -> None:
    """Each object's place, and three standard deviations of it."""
    for entry in objects.objects:
        T_world_object = objects.state(entry).T_world_object
        R = T_world_object.rotation().matrix()
        covariance = (R @ objects.marginals(entry).matrix[3:6, 3:6] @ R.T)[:2, :2]
        angles = np.linspace(0, 2 * np.pi, 60)
        ring = 3 * np.linalg.cholesky(covariance) @ [np.cos(angles), np.sin(angles)]
        centre = T_world_object.translation()[:2]
        axis.plot(*(centre[:, None] + ring), color="tab:green")
        axis.annotate(entry.name, centre)


def trajectory(poses: list[gtsam.Pose3]) -> objgraph.datasets.Trajectory:
    times = np.arange(len(poses), dtype=float)
    return objgraph.datasets.Trajectory(times, np.stack([pose.matrix() for pose in poses]))


def main(arguments: Arguments) -> None:
    scan = objgraph.load_scan("sample", Path("out"), frames=arguments.frames, laps=arguments.laps)
    frames = [scan.frames[k] for k in range(len(scan.frames))]
    truth = [gtsam.Pose3(frame.T_world_camera) for frame in frames]
    instances = scan.instances[: arguments.objects]
    rng = np.random.default_rng(arguments.seed)
    motions = objgraph.slam.drifting_motions(truth, objgraph.slam.OdometryNoise(), rng)
    odometry = objgraph.slam.dead_reckoning(truth[0], motions)

    objects, seconds = objgraph.IncrementalObjectGraph(scan.up_world, floor=0.0), []
    recording = None
    if arguments.rerun is not None:
        recording = objgraph.show.rerun_view.new_recording("incremental")
    for k, (frame, pose) in enumerate(zip(frames, odometry, strict=True)):
        start = time.perf_counter()
        frame = replace(frame, T_world_camera=pose.matrix())  # the true pose is forgotten
        report = objects.update(frame, detections(frame, instances, rng))
        seconds.append(time.perf_counter() - start)
        if recording is not None:
            objgraph.show.rerun_view.log_incremental(objects, frame, recording)
        print(f"frame {k}: {seconds[-1]:.1f} s, sees {', '.join(report.seen) or 'nothing known'}", flush=True)
        for reason in report.reasons:
            print("   ", reason)

    if recording is not None and arguments.rerun is not None:
        objgraph.show.rerun_view.save_recording(recording, arguments.rerun)

    paths = {
        "truth": trajectory(truth),
        "odometry": trajectory(odometry),
        "with_objects": trajectory([objects.pose(camera) for camera in objects.cameras]),
    }
    error = objgraph.datasets.absolute_trajectory_error
    metrics = {
        "ate_odometry_m": error(paths["odometry"], paths["truth"]),
        "ate_with_objects_m": error(paths["with_objects"], paths["truth"]),
        "objects": len(objects.objects),
        "objects_in_the_room": len(instances),
        "median_seconds": float(np.median(seconds)),
    }
    arguments.out.mkdir(parents=True, exist_ok=True)
    (arguments.out / "metrics.json").write_text(json.dumps(metrics, indent=1) + "\n")
    print(metrics)
    figure, axis = plt.subplots(figsize=(7, 7))
    for (name, path), color in zip(paths.items(), ("0.4", "tab:red", "tab:blue"), strict=True):
        objgraph.datasets.write_tum(arguments.out / f"{name}.txt", path)
        label = name.replace("_", " ")
        axis.plot(*path.positions[:, :2].T, ".-", color=color, label=label, linewidth=1)
    draw_objects(objects, axis)
    axis.set(aspect="equal", xlabel="x, m", ylabel="y, m")
    axis.legend()
    figure.savefig(arguments.out / "map.png", dpi=110, bbox_inches="tight")


if __name__ == "__main__":
    main(tyro.cli(Arguments))
