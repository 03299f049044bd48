"""A ScanNet scan as one GTSAM graph, built by hand: objects are variables, each view adds two factors.

    python examples/scannet_graph.py --out out/example
    python examples/scannet_graph.py --root ../shared/data/scannet --scene scene0470_00 --out out/scene0470

Without `--root` the project's own sample scan is generated and mapped.
"""

import time
from dataclasses import dataclass
from pathlib import Path

import gtsam
import numpy as np
import tyro
from rich.console import Console
from rich.progress import track

from factors.base import Annealing
from factors.depth import DepthFactor
from factors.filled_box import FilledBoxFactor
from factors.floor import FloorFactor
from factors.full_distribution import FullDistribution
from factors.priors import code_prior, scale_prior, upright_prior
from factors.state import ObjectKeys, ObjectState
from factors.surface import SurfaceFactor
from factors.weighting import Weighting
from objgraph.bench.metrics.maps import evaluate_map
from objgraph.bench.metrics.tables import evaluation_table
from objgraph.covariance.posterior import marginals
from objgraph.covariance.surface import surface_sigma
from objgraph.datasets.ground_truth import annotated
from objgraph.datasets.registry import load_scan
from objgraph.graph.builder import GraphConfig, ObjectBuilder
from objgraph.graph.initialise import InitialisationConfig, guesses, rank
from objgraph.graph.solve import LevenbergMarquardtConfig, Problem, minimize
from objgraph.maps.mapped_object import MappedObject
from objgraph.maps.object_map import ObjectMap
from objgraph.maps.pipeline import scene_floor, scene_points
from objgraph.observation.sampling import observe
from objgraph.observation.view_selection import summarize
from objgraph.priors.mesh import extract_mesh
from objgraph.priors.registry import prior_for
from objgraph.show.map_picture import map_picture
from objgraph.show.tables import map_table


@dataclass
class Arguments:
    out: Path
    """Where the map and its picture go."""
    root: Path | None = None
    """Folder of ScanNet's layout; the sample scan where none is given."""
    scene: str | None = None
    views: int = 3


def describe(instance, state, covariance, mesh, sigma, views, seconds) -> MappedObject:
    return MappedObject(
        instance.id, instance.category, "mapped",
        T_world_object=state.T_world_object.matrix(), scale=state.scale, code=state.code,
        covariance=covariance.rigid, code_sigma=covariance.sigma[9:],
        seconds=seconds, size_m=state.scale * mesh.extents,
        views=tuple(view.frame for view in views), cameras=np.array([view.T_world_camera.matrix() for view in views]),
        vertices=state.to_world(np.asarray(mesh.vertices)), faces=np.asarray(mesh.faces), vertex_sigma=sigma,
    )  # fmt: skip


def main(arguments: Arguments) -> None:
    dataset, root = ("scannet", arguments.root) if arguments.root else ("sample", Path("out/sample"))
    scan = annotated(load_scan(dataset, root, arguments.scene))
    index = summarize(scan.frames)
    floor = scene_floor(scan)

    # One graph and one set of values for the whole scene; a SLAM system would bring its own.
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    observed, seconds = {}, {}
    for instance in track(scan.instances, "building the graph"):
        start = time.perf_counter()
        prior = prior_for(instance.category)
        frames = index.select(instance.id, arguments.views)
        views = [observe(scan.frames[i], instance.id) for i in frames]

        # First guess: the prior's mean shape, tried at eight headings on a few points and rays.
        states = guesses(prior, views, scan.up_world, floor, InitialisationConfig())
        (state, *_), _ = rank(
            prior, views, states, ObjectBuilder(GraphConfig(), scan.up_world, floor), InitialisationConfig()
        )

        # Variables o{i} (Pose3), s{i} (log-scale), z{i} (shape code), and what is known of them beforehand.
        keys = ObjectKeys.numbered(instance.id)
        state.insert(values, keys)
        graph.push_back(code_prior(keys, prior.code_mean, prior.code_covariance))
        graph.push_back(
            scale_prior(keys, np.log(prior.size_mean), prior.size_log_sigma, prior.anisotropy_sigma or 0.1)
        )
        graph.push_back(upright_prior(keys, scan.up_world, sigma=0.03))

        # Two factors a view: its points lie on the surface, its rays end there or pass by.
        factors = []
        for view in views:
            factors += [
                SurfaceFactor(
                    keys, prior.decoder, view.T_world_camera, view.points_camera, view.points_sigma,
                    prior_sigma=prior.residual_sigma, weighting=Weighting("information", view.points_share),
                ),
                DepthFactor(
                    keys, prior.decoder, view.T_world_camera, view.rays,
                    renderer=FullDistribution(), prior_sigma=prior.residual_sigma, weighting=Weighting("information", view.rays_share),
                ),
            ]  # fmt: skip
        # A code's shape is as large as the box that all shapes of the prior fill: the scales are then its size.
        if prior.box is not None:
            factors.append(FilledBoxFactor(keys, prior.decoder, prior.box, 2.0 * prior.residual_sigma))
        if floor is not None:  # nothing of an object lies below the floor: rays from underneath end at it
            factors.append(
                FloorFactor(keys, prior.decoder, scan.up_world, floor, prior_sigma=prior.residual_sigma)
            )
        for factor in factors:
            graph.push_back(factor.gtsam_factor())
        observed[instance.id] = (instance, prior, keys, views, factors)
        seconds[instance.id] = time.perf_counter() - start

    # Freeze, solve, refresh: noise and ray samples are held while a quadratic is minimised, then renewed.
    factors = [factor for *_, own in observed.values() for factor in own]
    problem = Problem("scene", graph, values, factors)
    for slope in track((60.0, 120.0, 240.0, 400.0, 400.0), "solving"):
        for factor in factors:
            factor.refresh(problem.values, Annealing(slope))
        minimize(problem, LevenbergMarquardtConfig(iterations=8))
    values = problem.values

    entries = []
    for instance, prior, keys, views, _ in observed.values():
        state = ObjectState.from_values(values, keys)
        covariance = marginals(graph, values, keys)
        mesh = extract_mesh(prior.decoder, state.code)
        of_surface = covariance.times(prior.surface_misfit)
        sigma = surface_sigma(prior.decoder, state, of_surface, np.asarray(mesh.vertices))
        entries.append(describe(instance, state, covariance, mesh, sigma, views, seconds[instance.id]))
    object_map = ObjectMap(scan.name, tuple(entries), scan.up_world)
    object_map.save(arguments.out)
    map_picture(object_map, *scene_points(scan, range(len(scan.frames)), 8000), arguments.out / "map.png")
    console = Console()
    errors = evaluate_map(object_map, scan.ground_truth)
    for table in (map_table(object_map), evaluation_table(object_map, errors)):
        console.print(table)


if __name__ == "__main__":
    main(tyro.cli(Arguments))
