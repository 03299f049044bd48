"""What is known of an object, and how well: marginals, the 9-DoF box, the surface, the depth a camera would measure.

    python examples/05_covariances.py --out out/covariances

A chair of the sample room is estimated from one view, then from three. Read the limits first: docs/guides/covariances.md.
"""

import json
from dataclasses import dataclass
from pathlib import Path

import gtsam
import numpy as np
import tyro
from rich.console import Console

import objgraph


@dataclass
class Arguments:
    out: Path
    """Where metrics.json goes."""
    object: int = 2
    """Of the sample's objects, which one."""
    views: int = 3
    """Views in the end."""


def main(arguments: Arguments) -> None:
    scan, console = objgraph.load_scan("sample", Path("out/sample")), Console()
    categories = {each.id: each.category for each in scan.instances}
    if arguments.object not in categories:
        there = ", ".join(f"{id} ({category})" for id, category in categories.items())
        raise SystemExit(f"--object {arguments.object}: the sample has {there}")
    category = categories[arguments.object]
    prior = objgraph.prior_for(category)
    best = objgraph.observation.summarize(scan.frames).select(arguments.object, arguments.views)
    frames = [scan.frames[i] for i in best]
    views = [objgraph.observe(frame, arguments.object) for frame in frames]

    found = []
    for count in (1, len(views)):
        graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        floor = objgraph.maps.scene_floor(scan)
        objects = objgraph.ObjectGraph(graph, values, up_world=scan.up_world, floor=floor)
        chair = objects.add_object(prior, views[:count], name=f"{category} {arguments.object}")
        for view in views[:count]:
            objects.observe(chair, view, camera=gtsam.Pose3(view.T_world_camera))
        objects.optimize()
        state, covariance = objects.state(chair), objects.marginals(chair)

        # The graph's own: 73 axes, each of which says what it is.
        rotation, translation = covariance.block("rotation"), covariance.block("translation")
        _, half_axes = translation.ellipsoid(
            0.95
        )  # directions (3, 3) in the object's frame, lengths (3,) in metres
        console.print(
            f"{count} views; longest half axis of the centre's ellipsoid: {100 * half_axes[0]:.1f} cm"
        )

        # In the world's axes, and as the paper has it: [t, phi, s].
        R_world_object = state.T_world_object.rotation()
        console.print(objgraph.covariance.in_world(covariance, R_world_object).block("translation").table())
        xi = objgraph.covariance.of_xi(covariance, state)  # these 9 axes, then the code's 64

        # The box as a 9-DoF pose: by the same marginals, which are too sure, and calibrated, with a verdict, as a map has it.
        box = objgraph.covariance.box_pose(prior, state, covariance)
        judgement = objgraph.trust.judge(objects, chair)
        assert judgement is not None  # only where the calibration knows nothing of such objects
        trust, calibrated = judgement.trust, judgement.box.covariance
        console.print(
            f"pose right: {trust.percent} %, {trust.word}; {'; '.join(trust.why) or 'nothing speaks against it'}"
        )

        # The depth that the first camera would measure about the object's middle, and its spread.
        camera = gtsam.Pose3(frames[0].T_world_camera)
        middle = np.round(
            frames[0].intrinsics.project(camera.transformTo(box.T_world_box.translation())[None])[0]
        )
        u, v = (middle + np.mgrid[-40:41:20, -40:41:20].reshape(2, -1).T).T
        rays = frames[0].intrinsics.backproject(u, v)  # (25, 3), z = 1
        depth = objgraph.covariance.predicted_depth(prior.decoder, state, covariance, camera, rays)
        found.append(
            {
                "views": count,
                "rotation_sigma_deg": np.degrees(rotation.sigma).tolist(),
                "translation_sigma_m": translation.sigma.tolist(),
                "xi_sigma": xi.sigma.tolist(),
                "box_centre_sigma_m": box.covariance.block("centre").sigma.tolist(),
                "box_centre_calibrated_sigma_m": calibrated.block("centre").sigma.tolist(),
                "pose_right": trust.pose,
                "box_extents_m": box.extents.tolist(),
                "hit_probability": depth.hit.tolist(),
                "depth_sigma_m": [None if np.isnan(sigma) else sigma for sigma in depth.sigma],
            }
        )
    arguments.out.mkdir(parents=True, exist_ok=True)
    (arguments.out / "metrics.json").write_text(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    main(tyro.cli(Arguments))
