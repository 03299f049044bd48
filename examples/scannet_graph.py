"""A ScanNet scan as one GTSAM graph, built by hand: objects are variables, each view adds two factors.

    python examples/scannet_graph.py --out out/example
    python examples/scannet_graph.py --root ../shared/data/scannet --scene scene0470_00 --out out/scene0470

Without `--root` the project's own sample scan is generated and mapped. `objgraph.ObjectGraph` does in a line or two what is
spelled out here.
"""

from dataclasses import dataclass
from pathlib import Path

import gtsam
import tyro
from rich.console import Console
from rich.progress import track

import factors
import objgraph


@dataclass
class Arguments:
    out: Path
    """Where the map and its picture go."""
    root: Path | None = None
    """Folder of ScanNet's layout; the sample scan where none is given."""
    scene: str | None = None
    views: int = 3


def main(arguments: Arguments) -> None:
    dataset, root = ("scannet", arguments.root) if arguments.root else ("sample", Path("out/sample"))
    scan = objgraph.load_scan(dataset, root, arguments.scene)
    index = objgraph.observation.summarize(scan.frames)  # which frames show which object how well
    floor = objgraph.maps.scene_floor(scan)
    builder = objgraph.ObjectBuilder(up_world=scan.up_world, floor=floor)

    # One graph and one set of values for the whole scene; a SLAM system would bring its own.
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    own: list[factors.ObservationFactor] = []
    observed = {}
    for instance in track(scan.instances, "building the graph"):
        prior = objgraph.prior_for(instance.category)
        frames = index.select(instance.id, arguments.views)
        views = [objgraph.observe(scan.frames[i], instance.id) for i in frames]

        # About where its views say that the object is, in its likeliest heading.
        state, _ = objgraph.place(prior, views, builder)

        # Variables o{i} (Pose3), s{i} (log-scale), z{i} (shape code), and what is known of them beforehand.
        keys = objgraph.ObjectKeys.numbered(instance.id)
        state.insert(values, keys)
        graph.push_back(prior.code_factor(keys))
        graph.push_back(prior.scale_factor(keys))
        graph.push_back(factors.upright_prior(keys, scan.up_world, sigma=0.03))

        # Two factors a view: its points lie on the surface, its rays end there or pass by.
        sigma = prior.residual_sigma
        for view in views:
            camera = view.T_world_camera  # or the key of a Pose3 that holds it
            own.append(
                factors.SurfaceFactor(
                    keys, prior.decoder, camera, view.points_camera, view.points_sigma,
                    prior_sigma=sigma, share=view.points_share,
                    tail=0.05,  # metres: what the mask holds of something else is let go
                )
            )  # fmt: skip
            own.append(
                factors.DepthFactor(
                    keys, prior.decoder, camera, view.rays,
                    prior_sigma=sigma, share=view.rays_share,
                )
            )  # fmt: skip
        # A code's shape is as large as the box that all shapes of the prior fill: the scales are then its size.
        if prior.box is not None:
            own.append(factors.FilledBoxFactor(keys, prior.decoder, prior.box, 2.0 * sigma))
        if floor is not None:  # nothing of an object lies below the floor: rays from underneath end at it
            own.append(
                factors.FloorFactor(
                    keys, prior.decoder, scan.up_world, floor, stands=prior.feet, prior_sigma=sigma
                )
            )
        observed[instance.id] = (instance, prior, keys, views)
    for factor in own:
        graph.push_back(factor.gtsam_factor())

    # Freeze, solve, refresh: noise and ray samples are held while a quadratic is minimised, then renewed.
    problem = objgraph.Problem("scene", graph, values, own)
    with Console().status("solving"):
        objgraph.solve([problem], objgraph.SolverConfig(rounds=8))

    entries = []
    for instance, prior, keys, views in observed.values():
        state = objgraph.ObjectState.from_values(problem.values, keys)
        covariance = objgraph.covariance.marginals(graph, problem.values, keys)
        estimate = objgraph.maps.Estimate(
            state, covariance, problem.cost_initial, problem.cost,
            problem.linearizations, problem.error_evaluations,
        )  # fmt: skip
        entries.append(objgraph.maps.map_entry(instance, prior, estimate, views))
    object_map = objgraph.ObjectMap(scan.name, tuple(entries), scan.up_world)
    object_map.save(arguments.out)
    points, colors = objgraph.maps.scene_points(scan, range(len(scan.frames)), 8000)
    objgraph.show.map_picture(object_map, points, colors, arguments.out / "map.png")
    Console().print(objgraph.show.map_table(object_map))


if __name__ == "__main__":
    main(tyro.cli(Arguments))
