"""What `objgraph evaluate --suite` runs, part by part."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

Suite = Literal["docs", "quick"]
_SHARED = "start,graph,graph-bare,ours,dsp-slam,node-slam,dsp-slam-gn,dsp-slam-gn-released"
_OWN = (
    "start@own,start-7dof@own,graph@own,graph-bare@own,ours@own,dsp-slam@own,node-slam@own,dsp-slam-gn@own,"
    "dsp-slam-gn-released@own"
)
_EFFECTS = (
    "ours,ours-released,ours+code-weight,ours+clipping,ours+depth-variance,ours+band,ours+world-scale,"
    "ours+first-view-depths,ours-det2d,ours-det2d-released,ours-det2d+squared,dsp-slam-gn,dsp-slam-gn-released,"
    "dsp-slam-gn-undamped,dsp-slam-gn-undamped+damping,dsp-slam-gn-undamped+huber,dsp-slam-gn+iterations,dsp-slam-gn+7dof,dsp-slam-gn+one-view"
)
_RATES = ("Rates with", "Medians", "Table II")


@dataclass(frozen=True)
class Part:
    """One run of the suite."""

    name: str
    """Of its folder."""
    title: str
    options: Mapping[str, Any]
    """Of `EvaluateCommand`; paths are relative to the folder of data."""
    tables: tuple[str, ...] = _RATES
    """Beginnings of the titles of the tables that the page shows."""
    pictures: tuple[str, ...] = ()


def parts(suite: Suite) -> list[Part]:
    """What a suite runs, in its order."""
    return _docs() if suite == "docs" else _quick()


def _docs() -> list[Part]:
    def methods(shapes: str) -> tuple[str]:
        # what the paper's method makes of floor and gravity takes as long as itself: once is enough
        return (f"{_SHARED},{_OWN}{',ours-floor' * (shapes == 'families')}",)

    found = [
        Part(
            f"{difficulty}-{shapes}", f"{difficulty.capitalize()}: {words}",
            {"difficulty": difficulty, "objects": objects, "views": ("3",), "methods": methods(shapes), **_shapes(shapes)},
            # rates in four bins of a few objects each would be chance
            pictures=("pose_over_faults.png",) * (objects >= 24) + ("error_against_uncertainty.png",),
        )
        for difficulty, objects in (("hard", 24), ("everyday", 8))
        for shapes, words in (
            ("families", "the benchmark's own families"),
            ("cad", "meshes made by people"),
            ("everyday", "meshes made by a generator"),
        )
    ]  # fmt: skip
    return [
        *found,
        Part(
            "views", "Everyday: one, two and three views",
            {"difficulty": "everyday", "objects": 12, "views": ("1,2,3",), "methods": ("start,graph@own,graph-bare,dsp-slam-gn",)},
            pictures=("error_against_views.png",),
        ),
        Part(
            "stability", "The same objects again",
            {"difficulty": "everyday", "objects": 6, "views": ("3",), "methods": ("start,graph@own,dsp-slam-gn",), "stability": True},
            ("The same",),
        ),
        Part(
            "released", "What the released programs do otherwise",
            {"difficulty": "everyday", "objects": 3, "views": ("3",), "methods": (_EFFECTS,)}, ("Rates with", "Medians"),
        ),
        Part(
            "scene0470", "A real scan: ScanNet scene0470_00",
            {
                "dataset": "scannet", "root": Path("scannet"), "scenes": ("scene0470_00",), "views": ("1,2,3",),
                "methods": (f"{_SHARED},{_OWN}",),
            },
        ),
        *_real("docs"),
    ]  # fmt: skip


def _quick() -> list[Part]:
    methods = {"views": ("3",), "methods": ("start,graph,graph-bare,dsp-slam-gn,start@own,dsp-slam-gn@own",)}
    return [
        Part("hard-families", "Hard: the benchmark's own families", {"difficulty": "hard", "objects": 3, **methods}),
        Part(
            "hard-everyday", "Hard: meshes made by a generator",
            {"difficulty": "hard", "objects": 2, **_shapes("everyday"), **methods},
        ),
        Part(
            "ours", "Everyday: the paper's method",
            {"difficulty": "everyday", "objects": 1, "views": ("3",), "methods": ("start@own,graph,ours,ours@own",)},
        ),
        *_real("quick"),
    ]  # fmt: skip


def _real(suite: Suite) -> list[Part]:
    """Real sensors, whose ground truth is boxes."""
    methods = _SHARED.removeprefix("start,") if suite == "docs" else "graph,dsp-slam-gn"
    views = ("1,2,3",) if suite == "docs" else ("3",)
    factors = (1.0, 2.0, 0.5) if suite == "docs" else (1.0,)
    cameras = [
        Part(
            name, f"A real sensor: {words}",
            {"dataset": name, "root": Path(folder), "methods": (methods,), "views": views}, ("Boxes",),
        )
        for name, folder, words in (
            ("sevenscenes", "sevenscenes", "7-Scenes redkitchen"),
            ("icl", "icl_livingroom1", "ICL living room"),
        )
    ]  # fmt: skip
    return cameras + [
        Part(
            f"kitti-{factor:g}", f"LiDAR: KITTI, a detector of {factor:g} times the noise that the graph is told",
            {
                "dataset": "kitti", "root": Path("kitti"), "detector_noise": factor,
                "methods": (methods if factor == 1 else "graph,dsp-slam-gn,dsp-slam-gn-released",),
                **({"scenes": ("000004,000007,000008",)} if suite == "quick" else {}),
            },
            ("Table III:",),
        )
        for factor in factors
    ]  # fmt: skip


def _shapes(shapes: str) -> dict[str, Any]:
    return {} if shapes == "families" else {"shapes": shapes, "meshes": Path("cad2")}
