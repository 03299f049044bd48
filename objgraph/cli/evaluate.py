"""What the command line does with methods: `objgraph evaluate`."""

import os
from pathlib import Path
from typing import Any

from rich.console import Console

from objgraph.bench.comparison.boxes.compare import KITTI, LidarComparison, compare_boxes
from objgraph.bench.comparison.boxes.report import box_report
from objgraph.bench.comparison.boxes.rgbd import rgbd_box_report
from objgraph.bench.comparison.contenders.methods import METHODS, method, released
from objgraph.bench.comparison.objects.cases import SYNTHETIC, CaseSource, SyntheticSource
from objgraph.bench.comparison.objects.compare import Comparison, compare
from objgraph.bench.comparison.objects.config import ComparisonConfig
from objgraph.bench.comparison.objects.report import calibration_report, object_report
from objgraph.bench.comparison.objects.rows import SHARED, STARTS, contender, method_and_start
from objgraph.bench.comparison.objects.scan_cases import ScanSource, read_split
from objgraph.bench.comparison.objects.stability import compare_again
from objgraph.bench.comparison.writing.report import Report
from objgraph.bench.worlds.cases import BenchmarkConfig
from objgraph.bench.worlds.viewpoints import VIEWS
from objgraph.cli.evaluate_command import EvaluateCommand
from objgraph.cli.progress import progress
from objgraph.cli.suite import run_suite
from objgraph.datasets.files import read_json
from objgraph.datasets.registry import datasets, has_boxes
from objgraph.errors import EvaluationError
from objgraph.synthetic.faults import FaultRanges, faults_from
from objgraph.trust.calibration import shipped_calibration
from objgraph.version import program_version


def run_evaluate(command: EvaluateCommand, console: Console, line: str) -> dict[str, Any]:
    """Compare, then write and show what came out; `line` is the command as it was typed.

    Raises:
        EvaluationError: an unknown method, data set or number; a folder that holds rows of other settings; or it was
            stopped, and can go on.
        DatasetError: the data cannot be read, or nothing is left of them.
    """
    if command.suite is not None:
        run_suite(command, console, run_evaluate)
        return {}
    if command.render is not None:
        raise EvaluationError("--render is for a --suite")
    if command.parts:
        raise EvaluationError("--parts is for a --suite")
    report = (_boxes if command.dataset == KITTI else _objects)(command, console)
    return report.publish(line, command.figures, command.folder, console)


def _objects(command: EvaluateCommand, console: Console) -> Report:
    """Tables I and II, or the calibration of the same rows; of boxes how well they agree."""
    if command.calibration and command.stability:
        raise EvaluationError("--calibration and --stability exclude each other: give one of them")
    comparison = _comparison(command)
    boxes = has_boxes(command.dataset)
    if boxes and (command.calibration or command.stability):
        raise EvaluationError(
            f"data set '{command.dataset}': --calibration and --stability are for data sets with true shapes"
        )
    _check_writable(command.figures)
    with progress(console, transient=True) as tell:
        rows = compare(comparison, command.workers, command.retry_failed, program_version(), tell)
        again = (
            compare_again(comparison, command.workers, program_version(), tell) if command.stability else []
        )
    if boxes:
        return rgbd_box_report(comparison, rows)
    return (
        calibration_report(comparison, rows, shipped_calibration())
        if command.calibration
        else object_report(comparison, rows, again)
    )


def _boxes(command: EvaluateCommand, console: Console) -> Report:
    """Table III: boxes of single scans."""
    if command.root is None:
        raise EvaluationError(f"data set '{KITTI}': --root must name its folder")
    if command.calibration or command.stability:
        raise EvaluationError(
            f"data set '{KITTI}': --calibration and --stability are for data sets with true shapes"
        )
    if not 0.0 <= command.detector_noise < float("inf"):
        raise EvaluationError(f"--detector-noise takes a number from 0 on, not {command.detector_noise}")
    _check_writable(command.figures)
    comparison = LidarComparison(
        command.root, _methods(command), command.folder, _scans(command), command.seed, command.priors,
        detector_noise=command.detector_noise,
    )  # fmt: skip
    with progress(console, transient=True) as tell:
        rows = compare_boxes(comparison, command.workers, command.retry_failed, program_version(), tell)
    return box_report(comparison, rows, command.least_points)


def _methods(command: EvaluateCommand) -> tuple[str, ...]:
    methods = _items(command.methods, "--methods")
    if command.released:
        methods = tuple(released(name) for name in methods)
    if not methods:
        raise EvaluationError(f"--methods names none; available: {', '.join(METHODS)}")
    for name in methods:
        chosen, start = method_and_start(name)
        method(chosen)
        if start not in STARTS:
            raise EvaluationError(f"no start '{start}' in {name}; there are {', '.join(STARTS)}")
    if command.jobs < 1:
        raise EvaluationError("--jobs must be at least 1")
    return methods


def _comparison(command: EvaluateCommand) -> Comparison:
    methods = _methods(command)
    config = ComparisonConfig(seed=command.seed, priors=tuple(command.priors))
    starts = _items(command.start, "--start")
    if wrong := [start for start in starts if start not in STARTS]:
        raise EvaluationError(f"--start takes {', '.join(STARTS)} or both; not '{wrong[0]}'")
    methods = tuple(dict.fromkeys(contender(*_started(name, start)) for start in starts for name in methods))
    return Comparison(_source(command), methods, _views(command), command.folder, config)


def _started(name: str, start: str) -> tuple[str, str]:
    """A method that names its start keeps it."""
    method, own = method_and_start(name)
    return method, own if own != SHARED else start


def _scans(command: EvaluateCommand) -> tuple[str, ...]:
    named = _items(command.scenes, "--scenes")
    if named and command.split is not None:
        raise EvaluationError("--scenes and --split exclude each other: give one of them")
    return named if command.split is None else read_split(command.split)


def _source(command: EvaluateCommand) -> CaseSource:
    categories = _items(command.categories, "--categories")
    if not categories:
        raise EvaluationError("--categories names none; give chair, table or, of --meshes, others")
    if command.dataset == SYNTHETIC:
        return _synthetic(command, categories)
    if command.dataset not in datasets():
        known = ", ".join([SYNTHETIC, KITTI, *datasets()])
        raise EvaluationError(f"no data set '{command.dataset}'; available: {known}")
    if command.root is None:
        raise EvaluationError(f"data set '{command.dataset}': --root must name its folder")
    options = {"scan2cad": command.scan2cad, "shapenet": command.shapenet}
    given = tuple((name, value) for name, value in options.items() if value is not None)
    return ScanSource(command.dataset, command.root, categories, _scans(command), given)


def _synthetic(command: EvaluateCommand, categories: tuple[str, ...]) -> SyntheticSource:
    if max(_views(command)) > VIEWS:
        raise EvaluationError(
            f"a synthetic object has {VIEWS} views; --views asks for {max(_views(command))}"
        )
    return SyntheticSource(
        BenchmarkConfig(
            seed=command.seed,
            size=command.size,
            objects=command.objects,
            categories=categories,
            spacing=command.spacing,
            difficulty=command.difficulty,
            faults=_faults(command),
            shapes=command.shapes or ("families" if command.meshes is None else "cad"),
            meshes=command.meshes,
        )
    )


def _faults(command: EvaluateCommand) -> FaultRanges | None:
    if command.faults is None:
        return None
    return faults_from(read_json(command.faults), command.difficulty)


def _views(command: EvaluateCommand) -> tuple[int, ...]:
    words = _items(command.views, "--views")
    wrong = [word for word in words if not word.isdecimal() or int(word) < 1]
    if wrong or not words:
        raise EvaluationError(f"--views takes numbers from 1 on, as in 1,2,3; not '{','.join(wrong)}'")
    return tuple(sorted({int(word) for word in words}))


def _items(words: tuple[str, ...], option: str) -> tuple[str, ...]:
    items = [item.strip() for word in words for item in word.split(",")]
    twice = [item for item in items if item and items.count(item) > 1]
    if twice:
        raise EvaluationError(f"{option} names {twice[0]} twice")
    return tuple(item for item in items if item)


def _check_writable(path: Path) -> None:
    folder = path.absolute().parent
    while not folder.exists():
        folder = folder.parent
    if path.is_dir() or not folder.is_dir() or not os.access(folder, os.W_OK):
        raise EvaluationError(f"{path} cannot be written: give a file in a folder that can be")
