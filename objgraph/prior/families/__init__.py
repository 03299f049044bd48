"""Procedural mesh families that the shape priors are trained on, beside collected meshes.

Each family draws a mesh in the canonical frame (y up, front at -z, bounding box centred, diagonal 1) from
a random generator. Meshes consist of closed parts that may overlap.
"""

from collections.abc import Callable

import trimesh
from numpy.random import PCG64, Generator, SeedSequence

from objgraph.prior.families import (
    conference,
    desks,
    framed,
    legged,
    round_tables,
    swivel,
    tables,
    upholstered,
)

Family = Callable[[Generator], trimesh.Trimesh]

FAMILIES: dict[str, dict[str, Family]] = {
    "chair": {
        "dining": legged.dining_chair,
        "shell": legged.shell_chair,
        "armchair": upholstered.armchair,
        "tub": upholstered.tub_chair,
        "stool": upholstered.stool,
        "bench": legged.bench,
        "folding": legged.folding_chair,
        "swivel": swivel.swivel_chair,
        "executive": swivel.executive_chair,
        "swivel_stool": swivel.swivel_stool,
        "pedestal": framed.pedestal_chair,
        "cantilever": framed.cantilever_chair,
        "lounge_frame": framed.lounge_frame,
    },
    "table": {
        "four_leg": tables.four_leg_table,
        "coffee": tables.coffee_table,
        "desk": desks.desk,
        "console": tables.console_table,
        "trestle": tables.trestle_table,
        "frame": tables.frame_table,
        "conference": conference.conference_table,
        "pedestal": round_tables.pedestal_table,
        "round_leg": round_tables.round_leg_table,
        "cross_base": round_tables.cross_base_table,
        "drum": round_tables.drum_table,
        "double_pedestal": round_tables.double_pedestal_table,
    },
}

SHARES: dict[str, dict[str, float]] = {
    "chair": {
        "swivel": 7.0,
        "dining": 5.0,
        "executive": 1.5,
        "armchair": 1.5,
        "stool": 1.5,
        "cantilever": 1.5,
    },
    "table": {"four_leg": 5.0, "conference": 4.0, "desk": 3.5, "pedestal": 2.0, "coffee": 2.0},
}
"""Relative number of meshes drawn from a family; 1 where it is not named."""


def draw(category: str, count: int, seed: int) -> list[tuple[str, trimesh.Trimesh]]:
    """`count` meshes of a category with their names, families in proportion to their shares.

    The i-th mesh depends on (seed, i) alone, so that a longer list begins with the shorter one.
    """
    families = FAMILIES[category]
    shares = [SHARES.get(category, {}).get(name, 1.0) for name in families]
    weights = [share / sum(shares) for share in shares]
    meshes = []
    for i in range(count):
        rng = Generator(PCG64(SeedSequence([seed, i])))
        name = str(rng.choice(list(families), p=weights))
        meshes.append((f"procedural/{name}_{seed}_{i:04d}", families[name](rng)))
    return meshes
