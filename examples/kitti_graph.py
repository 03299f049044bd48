"""Cars from one LiDAR scan and a detector's boxes, each a small factor graph built by hand.

    python examples/kitti_graph.py --out out/street
    python examples/kitti_graph.py --root ../shared/data/kitti --frame 000008 --out out/kitti

Without `--root` the project's own street is generated. A car is three variables: its pose, its log-scale and its shape
code. The detector's box, the road and the returns on and beside the car each say something of them.
"""

import json
from dataclasses import dataclass
from pathlib import Path

import gtsam
import numpy as np
import tyro
from rich.console import Console
from rich.progress import track

from factors.depth import DepthFactor
from factors.floor import FloorFactor, floor_share
from factors.full_distribution import FullDistribution
from factors.priors import code_prior, placed_prior, scale_prior, sized_prior, upright_prior
from factors.state import ObjectKeys, ObjectState
from factors.surface import SurfaceFactor
from factors.weighting import Weighting
from objgraph.covariance.labelled import ObjectCovariance
from objgraph.covariance.posterior import marginals
from objgraph.datasets.kitti import load_frame, load_labels
from objgraph.errors import ObservationError
from objgraph.estimate.task import Estimate
from objgraph.geometry.boxes import OrientedBox, box_iou
from objgraph.graph.solve import Problem, solve
from objgraph.maps.entry import found, map_entry
from objgraph.maps.mapped_object import MappedObject
from objgraph.maps.object_map import ObjectMap
from objgraph.observation.frames import Instance
from objgraph.observation.lidar.observe import observe_lidar
from objgraph.observation.lidar.road import road_under
from objgraph.priors.registry import prior_for
from objgraph.show.street_picture import street_picture
from objgraph.show.tables import map_table
from objgraph.synthetic.street import ensure_street


@dataclass
class Arguments:
    out: Path
    """Where the map, its picture and metrics.json go."""
    root: Path | None = None
    """Folder of KITTI's layout; the street where none is given."""
    frame: str = "000000"
    """Which scan."""


def car_graph(frame, detection, prior, keys):
    """The graph of one car, its first values, its factors that decode, and its view."""
    road = road_under(frame.p_world, frame.up_world, detection)
    view = observe_lidar(frame, detection, road)
    up = frame.up_world if road is None else road.normal_world
    detected = gtsam.Pose3(detection.T_world_object)
    log_scale = np.log(detection.size / prior.box)

    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    ObjectState(detected, log_scale, np.array(prior.code_mean)).insert(values, keys)

    # What is known beforehand: shapes and sizes of cars, and where the detector has this one.
    graph.push_back(code_prior(keys, prior.code_mean, 9.0 * prior.code_covariance))
    graph.push_back(scale_prior(keys, np.log(prior.size_mean), prior.size_log_sigma, prior.anisotropy_sigma))
    graph.push_back(placed_prior(keys, detected, np.radians(8.0), 0.3, 0.3))
    graph.push_back(sized_prior(keys, log_scale, 0.08))
    graph.push_back(upright_prior(keys, up, sigma=0.05))

    # What the scan says: returns lie on the surface, beams end there or pass by, the wheels stand on the road.
    prior_sigma = prior.residual_sigma
    factors = [
        SurfaceFactor(
            keys, prior.decoder, view.T_world_camera, view.points_camera, view.points_sigma,
            prior_sigma=prior_sigma, weighting=Weighting("information", view.points_share),
        ),
        DepthFactor(
            keys, prior.decoder, view.T_world_camera, view.rays, renderer=FullDistribution(),
            prior_sigma=prior_sigma, weighting=Weighting("information", view.rays_share),
        ),
    ]  # fmt: skip
    if road is not None:
        factors.append(
            FloorFactor(
                keys, prior.decoder, up, road.height, sigma=0.05, spacing=0.3, stands=prior.feet,
                prior_sigma=prior_sigma, weighting=Weighting("information", floor_share(0.3)),
            )
        )  # fmt: skip
    for factor in factors:
        graph.push_back(factor.gtsam_factor())
    return Problem(detection.name, graph, values, factors), view


def main(arguments: Arguments) -> None:
    root = arguments.root or ensure_street(Path("out"))
    frame = load_frame(root, arguments.frame)
    prior = prior_for("car")
    problems, views, entries = {}, {}, {}
    for detection in track(frame.detections, "building the graphs"):
        try:
            keys = ObjectKeys.numbered(detection.id)
            problems[detection.id], views[detection.id] = car_graph(frame, detection, prior, keys)
        except ObservationError as error:
            entries[detection.id] = MappedObject(detection.id, detection.category, "failed", str(error))

    # All cars in lockstep: they share no unknown, but one call of the decoder serves them all.
    solve(list(problems.values()))
    for number, problem in track(problems.items(), "covariances and meshes"):
        keys = ObjectKeys.numbered(number)
        covariance: ObjectCovariance = marginals(problem.graph, problem.values, keys)
        state = ObjectState.from_values(problem.values, keys)
        estimate = Estimate(
            state,
            covariance,
            problem.cost_initial,
            problem.cost,
            problem.linearizations,
            problem.error_evaluations,
        )
        instance = Instance(number, prior.category)
        entries[number] = map_entry(instance, prior, found(estimate, problem.name), [views[number]], 64)

    object_map = ObjectMap(frame.name, tuple(entries[i] for i in sorted(entries)), frame.up_world)
    object_map.save(arguments.out)
    truths = [label.box for label in load_labels(root, arguments.frame) if label.type == "Car"]
    street_picture(object_map, frame, arguments.out / "street.png", truths)
    Console().print(map_table(object_map))
    detected = [each.box for each in frame.detections]
    estimated = [
        OrientedBox.about(np.asarray(e.vertices), e.state.T_world_object.rotation().matrix())
        for e in object_map.mapped
    ]
    metrics = {
        "detected": len(detected),
        "mapped": len(estimated),
        "mean_iou_detections": float(
            np.mean([max(box_iou(box, truth) for truth in truths) for box in detected])
        ),
        "mean_iou": float(np.mean([max(box_iou(box, truth) for truth in truths) for box in estimated])),
    }
    (arguments.out / "metrics.json").write_text(json.dumps(metrics, indent=1) + "\n")
    print(metrics)


if __name__ == "__main__":
    main(tyro.cli(Arguments))
