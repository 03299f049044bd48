"""Objects of real scans that have an annotated model: ScanNet with Scan2CAD, or another data set that is registered."""

import hashlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from objgraph.datasets.ground_truth import AnnotatedScan, GroundTruth, TrueBox
from objgraph.datasets.registry import load_annotated, scenes
from objgraph.errors import DatasetError
from objgraph.observation.frames import Instance
from objgraph.observation.view_selection import ViewIndex, ViewSelectionConfig, summarize

Options = tuple[tuple[str, Any], ...]


@dataclass(frozen=True)
class ScanCase:
    """One annotated object of one scan."""

    dataset: str
    root: Path
    scene: str
    instance: Instance
    shape: str
    options: Options = ()
    """Of the loader."""
    view: ViewSelectionConfig = field(default_factory=ViewSelectionConfig)

    @property
    def id(self) -> str:
        return f"{self.scene}/{self.instance.id}"

    @property
    def difficulty(self) -> str:
        return ""

    @property
    def shapes(self) -> str:
        return ""

    @property
    def category(self) -> str:
        return self.instance.category

    def scan(self) -> AnnotatedScan:
        """The whole scan."""
        return _scan(self.dataset, self.root, self.scene, self.options)

    def views(self, count: int) -> tuple[int, ...]:
        """By the rule of `ViewIndex.select`; raises `ObservationError` where no frame sees the object."""
        index = _index(self.dataset, self.root, self.scene, self.options, self.view)
        return tuple(index.select(self.instance.id, count))


@dataclass(frozen=True)
class ScanSource:
    """The annotated objects of some categories in some scans."""

    dataset: str
    root: Path
    categories: tuple[str, ...]
    scenes: tuple[str, ...] = ()
    """By default all under `root`."""
    options: Options = ()
    """Of the loader."""
    view: ViewSelectionConfig = field(default_factory=ViewSelectionConfig)
    """How an object's frames are chosen."""

    def settings(self) -> dict[str, Any]:
        """Where the scans lie and how frames are chosen; which of them are taken changes no object."""
        options = {name: str(value) for name, value in self.options}
        return {"root": str(self.root.resolve()), "options": options, "view": vars(self.view)}

    def cases(self, progress: Callable[[int, int], None] | None = None) -> list[ScanCase]:
        """All annotated objects, scan by scan.

        Raises:
            DatasetError: a scan or its annotation cannot be read, or no object is left.
        """
        names = self.scenes or tuple(scenes(self.dataset, self.root))
        found, known = [], set()
        for done, name in enumerate(names, 1):
            scan = _scan(self.dataset, self.root, name, self.options)
            known |= {instance.category for instance in scan.instances if instance.id in scan.ground_truth}
            found += [self._case(name, i, scan.ground_truth) for i in scan.instances if self._wanted(i, scan)]
            if progress is not None:
                progress(done, len(names))
        if not found:
            raise DatasetError(
                f"{self.root}: no annotated object of {', '.join(self.categories)} in {len(names)} scans; "
                f"annotated are: {', '.join(sorted(known)) or 'none'}"
            )
        return found

    def _wanted(self, instance: Instance, scan: AnnotatedScan) -> bool:
        return instance.category in self.categories and instance.id in scan.ground_truth

    def _case(self, scene: str, instance: Instance, truths: Mapping[int, GroundTruth]) -> ScanCase:
        truth = truths[instance.id]
        # a box does not tell which objects are of one model
        shape = f"{scene}/{instance.id}" if isinstance(truth, TrueBox) else mesh_digest(truth)
        return ScanCase(self.dataset, self.root, scene, instance, shape, self.options, self.view)


def read_split(path: Path) -> tuple[str, ...]:
    """Names of scans from a file with one a line, as the paper's data_split; empty lines and # are left out.

    Raises:
        DatasetError: the file cannot be read, or names none.
    """
    try:
        lines = [line.split("#")[0].strip() for line in path.read_text().splitlines()]
    except (OSError, UnicodeDecodeError) as error:
        raise DatasetError(f"{path}: no list of scans ({error})") from error
    names = tuple(dict.fromkeys(line for line in lines if line))
    if not names:
        raise DatasetError(f"{path}: names no scan; one a line is expected")
    return names


def mesh_digest(truth: GroundTruth) -> str:
    """A name for a CAD model by its geometry: the same model has the same one in every scan."""
    digest = hashlib.sha256(np.ascontiguousarray(truth.vertices, np.float64).tobytes())
    digest.update(np.ascontiguousarray(truth.faces, np.int64).tobytes())
    return digest.hexdigest()[:16]


@lru_cache(maxsize=2)
def _scan(dataset: str, root: Path, scene: str, options: Options) -> AnnotatedScan:
    return load_annotated(dataset, root, scene, **dict(options))


@lru_cache(maxsize=2)
def _index(dataset: str, root: Path, scene: str, options: Options, view: ViewSelectionConfig) -> ViewIndex:
    """The frames' summaries are computed once a scan."""
    return summarize(_scan(dataset, root, scene, options).frames, view)
