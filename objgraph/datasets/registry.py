"""The data sets that can be mapped, by name."""

import inspect
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from types import ModuleType
from typing import Any, Protocol, get_args

from objgraph.datasets import (
    bag,
    bop,
    folder,
    icl,
    kitti,
    lidar,
    nerfstudio,
    sample,
    scannet,
    sevenscenes,
    tum,
)
from objgraph.datasets.ground_truth import AnnotatedScan, TrueBox, annotated
from objgraph.errors import DatasetError
from objgraph.observation.frames import Scan
from objgraph.observation.lidar.frame import LidarFrame


class Load(Protocol):
    """Reads a scan; further keyword options are the loader's own."""

    def __call__(self, root: Path, scene: str | None = None) -> Scan: ...


class Scenes(Protocol):
    """Names of the scans under a data set's folder."""

    def __call__(self, root: Path) -> list[str]: ...


@dataclass(frozen=True)
class Loader:
    """A data set's functions."""

    load: Load
    scenes: Scenes
    boxes: Callable[[Path, str], dict[int, TrueBox]] | None = None
    """True boxes of a scan's objects by instance id, where they are the ground truth that there is."""


_LOADERS: dict[str, Loader] = {
    "bag": Loader(bag.load, bag.scenes),
    "bop": Loader(bop.load, bop.scenes),
    "folder": Loader(folder.load, folder.scenes),
    "icl": Loader(icl.load, icl.scenes, icl.boxes),
    "nerfstudio": Loader(nerfstudio.load, nerfstudio.scenes),
    "sample": Loader(sample.load, sample.scenes),
    "scannet": Loader(scannet.load, scannet.scenes),
    "sevenscenes": Loader(sevenscenes.load, sevenscenes.scenes, sevenscenes.boxes),
    "tum": Loader(tum.load, tum.scenes),
}


_LIDAR = {"kitti": kitti, "lidar": lidar, "street": kitti}
"""Modules with `frames` and `load_frame`."""


def datasets() -> list[str]:
    """Names that `load_scan` knows."""
    return sorted(_LOADERS)


def register(name: str, loader: Loader) -> None:
    """Make a data set of the caller's own known under `name`; an existing name is an error."""
    if name in _LOADERS:
        raise DatasetError(f"a data set '{name}' is registered already")
    _LOADERS[name] = loader


def scenes(dataset: str, root: Path) -> list[str]:
    """Names of the scans under `root`."""
    return _loader(dataset).scenes(_place(root))


def load_scan(dataset: str, root: Path, scene: str | None = None, **options: Any) -> Scan:
    """The scan `scene` of a data set under `root`; None where there is only one.

    `options` are those of the loader (see its `load`); a path may be text, as `root` may. Raises `DatasetError` for an unknown data set, scene or
    option (it lists those available), and for files that are missing or damaged.
    """
    load = _loader(dataset).load
    parameters = inspect.signature(load).parameters.values()
    known = {p.name: p.annotation for p in parameters if p.kind is p.KEYWORD_ONLY}
    unknown = sorted(set(options) - set(known))
    if unknown:
        raise DatasetError(
            f"data set '{dataset}' has no option {', '.join(unknown)}; it has {', '.join(known)}"
        )
    for name, value in options.items():
        if isinstance(value, str) and Path in get_args(known[name]):
            options[name] = Path(value)
    return load(_place(root), scene, **options)


def has_boxes(dataset: str) -> bool:
    """Whether it is a data set of scans whose ground truth is boxes alone."""
    return dataset in _LOADERS and _LOADERS[dataset].boxes is not None


def load_annotated(dataset: str, root: Path, scene: str, **options: Any) -> AnnotatedScan:
    """See `load_scan`; with all ground truth that there is, for the evaluation alone."""
    scan, boxes = annotated(load_scan(dataset, root, scene, **options)), _loader(dataset).boxes
    return scan if boxes is None else replace(scan, ground_truth=boxes(_place(root), scene))


def load_lidar_frame(dataset: str, root: Path, frame: str | None = None) -> LidarFrame:
    """One scan of a LiDAR: of "kitti", "lidar", or "street", the project's own, which is generated under `root`.

    Raises:
        DatasetError: there is no such data set or frame, or a file is missing or damaged.
    """
    if dataset == "street":
        root, frame = _street(root), frame or kitti.frames(_street(root))[0]
    return _lidar(dataset).load_frame(_place(root), frame)


def lidar_frames(dataset: str, root: Path) -> list[str]:
    """Names of the scans of a LiDAR; raises as `load_lidar_frame`."""
    return _lidar(dataset).frames(_street(root) if dataset == "street" else _place(root))


def _place(root: Path) -> Path:
    """The path; raises DatasetError where no file system takes its name."""
    root = Path(root)
    try:
        root.exists()
    except OSError as error:
        raise DatasetError(f"{root}: no folder can have this name ({error.strerror})") from error
    return root


def _lidar(dataset: str) -> ModuleType:
    if dataset not in _LIDAR:
        raise DatasetError(f"no data set '{dataset}' of LiDAR scans; available: {', '.join(_LIDAR)}")
    return _LIDAR[dataset]


def _street(root: Path) -> Path:
    from objgraph.synthetic.street import ensure_street  # renders, with open3d: slow to import

    return ensure_street(_place(root))


def _loader(dataset: str) -> Loader:
    if dataset not in _LOADERS:
        known = f"{', '.join(datasets())}; of a LiDAR's scans {', '.join(_LIDAR)}"
        raise DatasetError(f"no data set '{dataset}'; available: {known}")
    return _LOADERS[dataset]
