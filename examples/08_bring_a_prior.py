"""A prior of your own: from a folder of meshes to a map that uses it.

    python examples/08_bring_a_prior.py --out out/prior
    python examples/08_bring_a_prior.py --prior sofa.safetensors --dataset scannet --root DIR --out out/sofas

Without `--prior` a small one is trained here, in a minute, on sixteen plain tables: too few to be good, enough to see every
step. A DeepSDF checkpoint becomes a prior by `objgraph convert-prior`. What training has to know: docs/guides/priors.md.
"""

import subprocess
import sys
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import trimesh
import tyro
from rich.console import Console

import objgraph


@dataclass
class Arguments:
    out: Path
    """Where meshes, prior and map go."""
    prior: Path | None = None
    """A prior's file; trained where none is given."""
    dataset: str = "sample"
    root: Path = Path("out/sample")
    steps: int = 600
    """Of the training."""


def plain_tables(folder: Path, count: int = 16) -> Path:
    """Meshes as training wants them: y up, front at -z, any size, here in metres."""
    folder.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(0)
    for i in range(count):
        width, height, depth = rng.uniform([0.7, 0.6, 0.5], [1.6, 0.8, 0.9])
        top, leg = rng.uniform(0.03, 0.06), rng.uniform(0.05, 0.09)
        parts = [trimesh.creation.box((width, top, depth))]
        parts[0].apply_translation((0, height - top / 2, 0))
        for x in (-1, 1):
            for z in (-1, 1):
                post = trimesh.creation.box((leg, height, leg))
                post.apply_translation((x * (width - leg) / 2, height / 2, z * (depth - leg) / 2))
                parts.append(post)
        trimesh.util.concatenate(parts).export(folder / f"table_{i:02}.ply")
    return folder


def train(meshes: Path, out: Path, steps: int) -> Path:
    """`objgraph train`, with a small network and without a first guess."""
    options = {
        "--category": "table", "--meshes": meshes, "--out": out, "--steps": steps, "--code-weight": 1e-3,
        "--decoder.width": 64, "--decoder.code-length": 8, "--decoder.mapping": 0, "--corpus.procedural": 0,
        "--corpus.copies": 1, "--corpus.swaps": 0, "--guess.steps": 0,
    }  # fmt: skip
    words = [str(word) for pair in options.items() for word in pair]
    subprocess.run([sys.executable, "-m", "objgraph.cli", "train", *words], check=True)
    return out / "table.safetensors"


def main(arguments: Arguments) -> None:
    file = arguments.prior
    if file is None:
        file = train(plain_tables(arguments.out / "meshes"), arguments.out / "train", arguments.steps)
    prior = objgraph.load_prior(file)
    print(prior.category, "codes of", len(prior.code_mean), "numbers, residual", prior.residual_sigma)

    # It serves its category in place of the shipped one; objects of others would be mapped as ever.
    scan = objgraph.load_scan(arguments.dataset, arguments.root)
    own = tuple(each for each in scan.instances if each.category == prior.category)
    config = objgraph.MappingConfig(priors=(str(file),), views=2)
    object_map = objgraph.map_scan(replace(scan, instances=own), config)
    object_map.save(arguments.out / "map")
    Console().print(objgraph.show.map_table(object_map))


if __name__ == "__main__":
    main(tyro.cli(Arguments))
