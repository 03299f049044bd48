"""A scan in, a map out: `objgraph map` in six lines of Python.

    python examples/01_map_a_scan.py --out out/first
    python examples/01_map_a_scan.py --dataset folder --root MYSCAN --out out/mine

Without `--root` the project's own room is generated. What a folder of yours has to hold: docs/guides/datasets.md.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro
from rich.console import Console

import objgraph


@dataclass
class Arguments:
    out: Path
    """Where the map and its picture go."""
    dataset: str = "sample"
    """Or folder, tum, scannet, sevenscenes, icl."""
    root: Path = Path("out/sample")
    """The data set's folder."""
    scene: str | None = None
    """Which scan, where the folder holds several."""
    views: int = 3
    """Of each object."""


def main(arguments: Arguments) -> None:
    scan = objgraph.load_scan(arguments.dataset, arguments.root, arguments.scene)
    object_map = objgraph.map_scan(scan, objgraph.MappingConfig(views=arguments.views))
    object_map.save(arguments.out)  # map.json, a GLB and a covariance for each object

    for entry in object_map.mapped:
        print(entry.category, entry.id)
        print("  T_world_object, metres:", entry.state.T_world_object.translation().round(2))
        print("  width, height, depth, metres:", np.asarray(entry.size_m).round(2))
        print("  vertices of its mesh, world frame:", np.asarray(entry.vertices).shape)
    for entry in object_map.objects:
        if entry.status == "failed":
            print(entry.category, entry.id, "could not be mapped:", entry.reason)

    Console().print(objgraph.show.map_table(object_map))
    points, colors = objgraph.maps.scene_points(scan, range(len(scan.frames)), 8000)
    objgraph.show.map_picture(object_map, points, colors, arguments.out / "map.png")


if __name__ == "__main__":
    main(tyro.cli(Arguments))
