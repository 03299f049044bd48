"""The project's own synthetic scan, generated where it is asked for; its layout is ScanNet's."""

from pathlib import Path

from objgraph.datasets import scannet
from objgraph.datasets.ground_truth import AnnotatedScan


def load(root: Path, scene: str | None = None) -> AnnotatedScan:
    """The sample scan; generated under `root` at the first call, which takes some seconds."""
    return scannet.load(_folder(root) / "scannet", scene)


def scenes(root: Path) -> list[str]:
    return scannet.scenes(_folder(root) / "scannet")


def _folder(root: Path) -> Path:
    from objgraph.synthetic.sample import ensure_sample  # renders, with open3d: slow to import

    return ensure_sample(root)
