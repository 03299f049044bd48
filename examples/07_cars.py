"""Cars from one LiDAR scan and a detector's boxes, each a few lines in a graph of its own.

    python examples/07_cars.py --out out/street
    python examples/07_cars.py --root ../shared/data/kitti --frame 000008 --out out/kitti

Without `--root` the project's own street is generated. A car is three variables: its pose, its log-scale and its shape
code. The detector's box, the road and the returns on and beside the car each say something of them. `objgraph map
--dataset kitti` does the same, all cars together.
"""

from dataclasses import dataclass
from pathlib import Path

import gtsam
import numpy as np
import tyro
from rich.console import Console
from rich.progress import track

import objgraph

ROADS = objgraph.GraphConfig(upright_sigma=0.05, floor_sigma=0.05, floor_spacing=0.3, sides=None)
"""Roads are less even than floors."""


@dataclass
class Arguments:
    out: Path
    """Where the map and its picture go."""
    root: Path | None = None
    """Folder of KITTI's layout; the street where none is given."""
    frame: str | None = None
    """Which scan; the first where none is named."""


def car_graph(frame, detection, prior):
    """The graph of one car, and its one view."""
    # The plane through the returns under the car says what is up, and where its wheels stand.
    road = objgraph.observation.road_under(frame.p_world, frame.up_world, detection)
    view = objgraph.observation.observe_lidar(frame, detection, road)
    up, height = (frame.up_world, None) if road is None else (road.normal_world, road.height)
    objects = objgraph.ObjectGraph(
        gtsam.NonlinearFactorGraph(), gtsam.Values(), ROADS, up_world=up, floor=height
    )

    # The detector's box is where the car begins, and a measurement of its place and size.
    box = objgraph.DetectedBox(
        gtsam.Pose3(detection.T_world_object), detection.size,
        position_sigma=0.3, heading_sigma=np.radians(8.0), size_sigma=0.08,
    )  # fmt: skip
    start = objgraph.ObjectState(box.T_world_object, box.log_scale(prior), np.array(prior.code_mean))
    car = objects.add_object(prior, start, box=box, name=detection.name)

    # Returns lie on the surface, beams end there or pass by, the wheels stand on the road.
    objects.observe(car, view)
    if road is not None:
        objects.stand_on_floor(car)
    return objects, car, view


def main(arguments: Arguments) -> None:
    dataset, root = ("kitti", arguments.root) if arguments.root else ("street", Path("out"))
    frame = objgraph.load_lidar_frame(dataset, root, arguments.frame)
    prior = objgraph.prior_for("car")
    entries = []
    for detection in track(frame.detections, "estimating"):
        instance = objgraph.Instance(detection.id, detection.category)
        try:
            objects, car, view = car_graph(frame, detection, prior)
            (problem,) = objects.optimize()
            estimate = objgraph.maps.Estimate(
                objects.state(car), objects.marginals(car), problem.cost_initial, problem.cost,
                problem.linearizations, problem.error_evaluations,
            )  # fmt: skip
            entries.append(objgraph.maps.map_entry(instance, prior, estimate, [view]))
        except objgraph.ObjectGraphError as error:  # one car's failure takes no other along
            entries.append(objgraph.maps.MappedObject(instance.id, instance.category, "failed", str(error)))

    object_map = objgraph.ObjectMap(frame.name, tuple(entries), frame.up_world)
    object_map.save(arguments.out)
    objgraph.show.street_picture(object_map, frame, arguments.out / "street.png")
    Console().print(objgraph.show.map_table(object_map))


if __name__ == "__main__":
    main(tyro.cli(Arguments))
