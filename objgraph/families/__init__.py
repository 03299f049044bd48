"""Procedural mesh families that the shape priors are trained on, beside collected meshes.

Each family draws a mesh in the canonical frame (y up, front at -z, bounding box centred, diagonal 1) from
a random generator. Meshes consist of closed parts that may overlap.
"""

from collections.abc import Callable

import trimesh
from numpy.random import PCG64, Generator, SeedSequence

from objgraph.families import (
    cars,
    conference,
    desks,
    framed,
    legged,
    lowpoly,
    occasional,
    round_tables,
    shells,
    slatted,
    stools,
    swivel,
    tables,
    upholstered,
    worktables,
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
        "folding": framed.folding_chair,
        "swivel": swivel.swivel_chair,
        "executive": swivel.executive_chair,
        "swivel_stool": swivel.swivel_stool,
        "pedestal": framed.pedestal_chair,
        "cantilever": framed.cantilever_chair,
        "lounge_frame": framed.lounge_frame,
        "bent_shell": shells.bent_shell_chair,
        "zigzag": shells.zigzag_chair,
        "legged_stool": stools.legged_stool,
        "step_stool": stools.step_stool,
        "bent_leg_stool": stools.bent_leg_stool,
        "crossed_stool": stools.crossed_stool,
        "block_stool": stools.block_stool,
        "bar_cluster": stools.bar_cluster,
        "chunky": lowpoly.chunky_chair,
        "block_armchair": lowpoly.block_armchair,
        "slatted": slatted.slatted_chair,
        "wooden_lounge": slatted.wooden_lounge,
        "parsons": slatted.parsons_armchair,
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
        "chunky": lowpoly.chunky_table,
        "chunky_round": lowpoly.chunky_round_table,
        "tray": occasional.tray_table,
        "rack": occasional.rack_console,
        "box": occasional.box_table,
        "framed_top": occasional.framed_top,
        "writing": worktables.writing_desk,
        "box_desk": worktables.box_desk,
        "tower": worktables.tower_desk,
        "end_frame": worktables.end_frame_table,
        "turned_trestle": worktables.turned_trestle,
        "cross_leg": worktables.cross_leg_table,
    },
    "car": {
        "sedan": cars.sedan,
        "hatchback": cars.hatchback,
        "estate": cars.estate,
        "suv": cars.suv,
        "van": cars.van,
        "minivan": cars.minivan,
        "pickup": cars.pickup,
        "sports": cars.sports,
        "toy": cars.toy,
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
        "bent_shell": 2.5,
        "chunky": 2.0,
        "legged_stool": 2.0,
        "slatted": 1.5,
        "parsons": 1.5,
        "zigzag": 0.4,
        "step_stool": 0.6,
        "crossed_stool": 0.6,
    },
    "table": {
        "four_leg": 5.0,
        "conference": 4.0,
        "desk": 3.5,
        "pedestal": 2.0,
        "coffee": 2.0,
        "chunky": 2.5,
        "writing": 2.0,
        "end_frame": 1.5,
        "box": 1.5,
        "box_desk": 1.5,
        "tower": 0.6,
    },
    "car": {"sedan": 3.0, "suv": 2.0, "hatchback": 2.0, "sports": 2.0, "toy": 1.5, "van": 1.5},
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
