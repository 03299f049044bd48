"""Pictures of the benchmark's furniture and cases: `python -m objgraph.bench.pictures.worlds --out docs/images`."""

from dataclasses import dataclass
from pathlib import Path
from typing import get_args

import matplotlib
import numpy as np
import tyro
from matplotlib.figure import Figure

from objgraph.bench.pictures.contact_sheet import draw_mesh
from objgraph.bench.worlds.cases import BenchmarkConfig, synthetic_cases
from objgraph.bench.worlds.families import FAMILIES, make_piece
from objgraph.bench.worlds.viewpoints import VIEWS
from objgraph.show.figure import finish, show
from objgraph.synthetic.faults import Difficulty

_OUTLINE = "#ff3cac"


@dataclass(frozen=True)
class PicturesConfig:
    """Where the pictures go."""

    out: Path
    """The folder for `benchmark_families.png` and `benchmark_clean.png`, `benchmark_everyday.png`, `benchmark_hard.png`."""
    seed: int = 1000
    """Of the furniture and the cases."""


def draw_families(path: Path, seed: int) -> None:
    """Every family once: a row of chairs and one of tables."""
    columns = max(len(families) for families in FAMILIES.values())
    figure = Figure(figsize=(1.7 * columns, 3.9), dpi=100, facecolor="white")
    for row, (category, families) in enumerate(FAMILIES.items()):
        for column, family in enumerate(families):
            mesh = make_piece(category, family, np.random.default_rng([seed, column])).mesh
            axis = figure.add_subplot(len(FAMILIES), columns, row * columns + column + 1)
            show(axis, draw_mesh(mesh, 160, 35.0, 22.0), family)
            axis.set_axis_off()
    figure.subplots_adjust(0.005, 0.01, 0.995, 0.93, 0.03, 0.14)
    finish(figure, None, None, path)


def draw_views(path: Path, seed: int, objects: int = 2, difficulty: Difficulty = "clean") -> None:
    """The three views of a few cases of each category, the target's mask outlined, and the depth of the last."""
    cases = synthetic_cases(BenchmarkConfig(seed=seed, objects=objects, difficulty=difficulty))
    columns = VIEWS + 1
    figure = Figure(figsize=(3.0 * columns, 2.42 * len(cases)), dpi=80, facecolor="white")
    for row, case in enumerate(cases):
        scan = case.scan()
        seen = scan.conditions.get("visible", [])
        for column in range(columns):
            frame = scan.frames[min(column, VIEWS - 1)]
            axis = figure.add_subplot(len(cases), columns, row * columns + column + 1)
            assert frame.color is not None
            words = f", {100 * seen[column]:.0f} % seen so far" if column < len(seen) else ""
            if column < VIEWS:
                show(axis, frame.color / 255.0, f"{case.category} {case.index}, view {column + 1}{words}")
                axis.contour(frame.instances == case.instance.id, [0.5], colors=[_OUTLINE], linewidths=1.2)
            else:
                depth = np.where(frame.depth > 0, frame.depth, np.nan)
                show(
                    axis,
                    matplotlib.colormaps["viridis"](depth / 5.0)[..., :3] * np.isfinite(depth)[..., None],
                    "its depth",
                )
    figure.subplots_adjust(0.01, 0.01, 0.99, 0.975, 0.02, 0.1)
    finish(figure, None, None, path)


def draw_pictures(config: PicturesConfig) -> None:
    """Both pictures."""
    config.out.mkdir(parents=True, exist_ok=True)
    draw_families(config.out / "benchmark_families.png", config.seed)
    for difficulty in get_args(Difficulty):
        draw_views(config.out / f"benchmark_{difficulty}.png", config.seed, difficulty=difficulty)


if __name__ == "__main__":
    draw_pictures(tyro.cli(PicturesConfig))
