"""Where to look next: the graph's covariance chooses the camera.

    python examples/06_next_view.py --out out/active

A chair of the sample room is mapped from one view. Then 100 cameras about it are ranked by what each is expected to tell of
it, from the map's covariance alone; no picture is taken. (`python -m objgraph.bench.active` measures what such views are
worth, and `objgraph next-view` ranks them for a saved map.)
"""

import json
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import tyro

import objgraph


@dataclass
class Arguments:
    out: Path
    """Where the map, the picture and metrics.json go."""
    object: int = 2
    """Of the sample's objects, which one."""
    distance: float = 1.8
    """Metres between the cameras and the object."""
    count: int = 100
    """Cameras to choose among."""


def main(arguments: Arguments) -> None:
    scan = objgraph.load_scan("sample", Path("out/sample"))
    one = tuple(instance for instance in scan.instances if instance.id == arguments.object)

    # One view of the object: much of it is unseen, and the covariance says so.
    object_map = objgraph.map_scan(replace(scan, instances=one), objgraph.MappingConfig(views=1))
    object_map.save(arguments.out)
    (target,) = objgraph.active.targets_from_map(object_map)

    # Candidates all about it; a robot would leave out where it cannot go (`objgraph.active.reachable`).
    cameras = objgraph.active.sphere(target.centre, arguments.distance, scan.up_world, arguments.count)
    ranked = objgraph.next_views([target], cameras)  # the expected decrease of the corners' mean square error

    # What the view that it was mapped from would tell once more, for comparison.
    (again,) = objgraph.next_views([target], target.seen_from)
    for i, view in enumerate(ranked[:5]):
        T_world_camera = view.T_world_camera
        eye, along = T_world_camera.translation(), T_world_camera.rotation().matrix()[:, 2]
        print(f"{i + 1}. from {np.round(eye, 2)} along {np.round(along, 2)}: {1e4 * view.total():.2f} cm²")
    print(f"the same view again: {1e4 * again.total():.2f} cm²")

    metrics = {
        "gains_m2": [view.total() for view in ranked],
        "gain_of_the_same_view_m2": again.total(),
        "best_T_world_camera": ranked[0].T_world_camera.matrix().tolist(),
    }
    (arguments.out / "metrics.json").write_text(json.dumps(metrics, indent=1) + "\n")
    picture = arguments.out / "information.png"
    objgraph.show.sphere_picture(target, target.surface_sigma, ranked, scan.up_world, picture)


if __name__ == "__main__":
    main(tyro.cli(Arguments))
