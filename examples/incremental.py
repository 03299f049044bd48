"""A map that grows frame by frame: drifting odometry and masks go in, objects and cameras come out.

    python examples/incremental.py --out out/incremental

A camera walks twice about a furnished room. No mask says which object of the map it is: that is for the association to
find. Whatever was decided is printed with its reason.
"""

import json
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import gtsam
import matplotlib.pyplot as plt
import numpy as np
import tyro

import objgraph
from objgraph.datasets.registry import load_scan
from objgraph.datasets.trajectory import Trajectory, absolute_trajectory_error, write_tum
from objgraph.observation.frames import Frame, Instance
from objgraph.priors.mesh import extract_mesh
from objgraph.slam.odometry import OdometryNoise, dead_reckoning, drifting_motions
from objgraph.synthetic.camera import CameraConfig
from objgraph.synthetic.sample import SampleConfig, ensure_sample

UP, FLOOR = np.array([0.0, 0.0, 1.0]), 0.0


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


def detections(
    frame: Frame, instances: Sequence[Instance], rng: np.random.Generator, least: int = 600
) -> list[Instance]:
    """What a detector would say of this frame: masks and categories, in an order that tells nothing."""
    seen = [i for i in instances if np.count_nonzero(frame.instances == i.id) >= least]
    return [seen[i] for i in rng.permutation(len(seen))]


def footprints(objects: objgraph.IncrementalObjectGraph, axis) -> None:
    """Each object's mesh from above, and three standard deviations of its place."""
    for entry in objects.objects:
        state = objects.state(entry)
        mesh = extract_mesh(entry.prior.decoder, state.code, resolution=40)
        points = state.to_world(np.asarray(mesh.vertices))
        axis.plot(*points[:, :2].T, ",", color="0.6")
        R = state.T_world_object.rotation().matrix()
        covariance = (R @ objects.marginals(entry).matrix[3:6, 3:6] @ R.T)[:2, :2]
        angles = np.linspace(0, 2 * np.pi, 60)
        ring = 3 * np.linalg.cholesky(covariance) @ [np.cos(angles), np.sin(angles)]
        centre = state.T_world_object.translation()[:2]
        axis.plot(*(centre[:, None] + ring), color="tab:green")
        axis.annotate(entry.name, centre)


def main(arguments: Arguments) -> None:
    config = SampleConfig(camera=CameraConfig(frames=arguments.frames, sweep_rad=2 * np.pi * arguments.laps))
    scan = load_scan("scannet", ensure_sample(Path("out"), config) / "scannet")
    times = np.arange(len(scan.frames), dtype=float)
    instances = scan.instances[: arguments.objects]
    truth = [gtsam.Pose3(scan.frames[k].T_world_camera) for k in range(len(scan.frames))]
    rng = np.random.default_rng(arguments.seed)
    motions = drifting_motions(truth, OdometryNoise(), rng)
    odometry = dead_reckoning(truth[0], motions)

    objects, seconds = objgraph.IncrementalObjectGraph(UP, floor=FLOOR), []
    for k, pose in enumerate(odometry):
        frame = replace(scan.frames[k], T_world_camera=pose.matrix())
        start = time.perf_counter()
        report = objects.update(frame, detections(frame, instances, rng))
        seconds.append(time.perf_counter() - start)
        print(f"frame {k}: {seconds[-1]:.1f} s, sees {', '.join(report.seen) or 'nothing known'}", flush=True)
        for reason in report.reasons:
            print("   ", reason)

    poses = {
        "truth": truth,
        "odometry": odometry,
        "with_objects": [objects.pose(camera) for camera in objects.cameras],
    }
    paths = {
        name: Trajectory(times, np.stack([pose.matrix() for pose in each])) for name, each in poses.items()
    }
    metrics = {
        "ate_odometry_m": absolute_trajectory_error(paths["odometry"], paths["truth"]),
        "ate_with_objects_m": absolute_trajectory_error(paths["with_objects"], paths["truth"]),
        "objects": len(objects.objects),
        "objects_in_the_room": len(instances),
        "median_seconds": float(np.median(seconds)),
    }
    arguments.out.mkdir(parents=True, exist_ok=True)
    (arguments.out / "metrics.json").write_text(json.dumps(metrics, indent=1) + "\n")
    figure, axis = plt.subplots(figsize=(7, 7))
    for (name, trajectory), color in zip(paths.items(), ("0.4", "tab:red", "tab:blue"), strict=True):
        write_tum(arguments.out / f"{name}.txt", trajectory)
        axis.plot(
            *trajectory.positions[:, :2].T, ".-", color=color, label=name.replace("_", " "), linewidth=1
        )
    footprints(objects, axis)
    axis.set_aspect("equal")
    axis.set_xlabel("x, m")
    axis.set_ylabel("y, m")
    axis.legend()
    figure.savefig(arguments.out / "map.png", dpi=110, bbox_inches="tight")
    print(metrics)


if __name__ == "__main__":
    main(tyro.cli(Arguments))
