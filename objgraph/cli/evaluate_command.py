"""The options of `objgraph evaluate`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from objgraph.bench.comparison.objects.cases import SYNTHETIC
from objgraph.bench.comparison.objects.rows import SHARED
from objgraph.bench.worlds.meshes import ShapeSet
from objgraph.cli.suite_parts import Suite
from objgraph.errors import EvaluationError
from objgraph.synthetic.faults import Difficulty
from objgraph.work import Engine, Workers

FIGURES = "figures.json"
"""The file of a comparison's figures, by default."""

List = Annotated[tuple[str, ...], tyro.conf.arg(metavar="A,B,..")]


@dataclass(frozen=True)
class EvaluateCommand:
    """Compare methods on objects with ground truth. Lists are separated by commas or spaces."""

    json: Path | None = None
    """File for the figures; by default `figures.json` in `out`."""
    dataset: str = SYNTHETIC
    """`synthetic`, or a data set with ground truth: `scannet`, `sevenscenes`, `icl`, `kitti`."""
    methods: List = ("graph", "ours")
    """Methods, by name."""
    out: Path | None = None
    """Folder for rows, tables and plots; a run that was stopped goes on there. By default beside the figures, named as
    their file is."""
    suite: Suite | None = None
    """Run all that docs/results.md shows (`docs`, many hours), or a part of it (`quick`, ten minutes), in folders under `out`;
    `root` is then the folder of all data."""
    parts: List = ()
    """Of a suite's parts these alone, by the names of their folders."""
    render: Path | None = None
    """Write the page of a suite's figures into this folder, and run nothing. The folder keeps the figures: of parts that are not
    in `out` the page shows what it kept."""
    views: List = ("1", "2", "3")
    """Numbers of views of each object."""
    categories: List = ("chair", "table")
    """Categories of objects."""
    seed: int = 0
    """Of the synthetic objects, and of everything that is sampled."""
    size: Literal["small", "standard", "full"] = "small"
    """Synthetic objects a category: 6, 24 or 100."""
    objects: int | None = None
    """Any other number of them; of a suite's parts no more than that, and a later run with more goes on."""
    start: List = (SHARED,)
    """Where methods begin: `shared`, all at the best of our initialisation, `own`, or both."""
    difficulty: Difficulty = "clean"
    """What is wrong with synthetic scans: next to nothing, what a careful user gets, or what ScanNet is like."""
    faults: Path | None = None
    """JSON file of faults' strengths that differ from the difficulty's (docs/reference/benchmark.md lists them)."""
    shapes: ShapeSet | None = None
    """Synthetic shapes: the project's `families`; of `meshes` what people made (`cad`) or a generator (`everyday`). By
    default what of these is there."""
    spacing: Literal["wide", "close"] = "wide"
    """How far apart the views of a clean synthetic object are."""
    meshes: Path | None = None
    """Folder of your own meshes, in subfolders by category, in place of the synthetic shapes."""
    root: Path | None = None
    """The folder of a data set of scans."""
    scenes: List = ()
    """Its scans by name (of kitti its frames); by default all."""
    split: Path | None = None
    """A file that names them, one a line."""
    scan2cad: Path | None = None
    """Folder of the Scan2CAD annotations; by default beside `root`."""
    shapenet: Path | None = None
    """Folder of the ShapeNet meshes; by default beside `root`."""
    priors: tuple[str, ...] = ()
    """Your own priors, .safetensors files: each serves its category in place of the shipped one."""
    jobs: int = 1
    """Processes, of one thread each."""
    engine: Engine = "local"
    """Whose processes: this machine's, or those of a Ray cluster (docs/guides/many-scenes.md)."""
    calibration: bool = False
    """Report how far covariances hold in place of how far estimates are right."""
    released: bool = False
    """Take `ours`, `ours-det2d` and `dsp-slam-gn` as the released programs are (docs/reference/benchmark.md), not as we would have them."""
    stability: bool = False
    """Estimate every object six times more, by other draws of points and with two threads, and report how far they differ."""
    retry_failed: bool = False
    """Run what failed before once more."""
    least_points: int = 50
    """Of kitti, cars with that many returns count."""
    detector_noise: float = 1.0
    """Of kitti, what the detections' errors are multiplied by; what the graph is told of them stays."""

    @property
    def workers(self) -> Workers:
        """Who makes the rows."""
        return Workers(self.jobs, self.engine)

    @property
    def folder(self) -> Path:
        """Of rows, tables and plots."""
        if self.out is not None:
            return self.out
        if self.json is None:
            raise EvaluationError("say where the figures go: --out names a folder, --json a file")
        return self.json.with_name(self.json.stem + "_rows")

    @property
    def figures(self) -> Path:
        """The file."""
        return self.json or self.folder / FIGURES
