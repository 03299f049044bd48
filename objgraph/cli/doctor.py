"""What the command line does: `objgraph doctor`."""

from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from objgraph.atomic import check_place
from objgraph.cli.progress import progress
from objgraph.cli.run_config import GENERATED, LIDAR_DATASETS, SAMPLE_ROOT, Topics
from objgraph.doctor import Finding, Section, examine_lidar, examine_machine, examine_scan
from objgraph.errors import DatasetError, OutputError

_PICTURE = "doctor.png"


@dataclass(frozen=True)
class DoctorCommand:
    """Say what is installed; with --root, what was understood of a data set and what is wrong with it.

    The exit status is 0 where nothing is wrong and 1 otherwise; notes do not count.
    """

    dataset: str | None = None
    """Data set: folder (the default with --root), sample, scannet, sevenscenes, icl, tum, bag, nerfstudio or bop; or kitti, lidar
    or street, scans of a LiDAR."""
    root: Path | None = None
    """The data set's folder; without it the program and the machine alone are looked at."""
    scene: str | None = None
    """Name of the scan (of kitti the frame, by default all); may be left out where there is only one."""
    trajectory: Path | None = None
    """Trajectory file in the TUM format in place of the data set's own; for folder, tum and bag."""
    topic: Topics = field(default_factory=Topics)
    """Of a bag, in place of guesses."""
    out: Path | None = None
    """Folder for doctor.png: the frame with most objects, their masks, the floor and the direction up."""


def run_doctor(command: DoctorCommand, console: Console) -> int:
    """Examine, print, draw what was asked for; the exit status.

    Raises:
        DatasetError: an option does not go with the data set, or nothing can be written to `out`.
    """
    if command == DoctorCommand():
        return _told(examine_machine(), console)
    dataset = command.dataset or "folder"
    if command.root is None and dataset not in GENERATED:
        raise DatasetError(f"data set '{dataset}': --root must name its folder")
    root = SAMPLE_ROOT if command.root is None else command.root
    examine = _lidar if dataset in LIDAR_DATASETS else _scan
    found = examine(dataset, root, command, console)  # first: a mistyped option is told at once
    return _told([*examine_machine(), *found], console)


def _scan(dataset: str, root: Path, command: DoctorCommand, console: Console) -> Iterable[Section]:
    if command.out is not None:
        check_place(command.out / _PICTURE, DatasetError)
    options = command.topic.options()
    if command.trajectory is not None:
        options["trajectory"] = command.trajectory
    with progress(console, transient=True) as tell:
        found = examine_scan(
            dataset, root, command.scene, lambda done, total: tell("reading frames", done, total),
            **options,
        )  # fmt: skip
    if command.out is not None and found.scan is not None:
        from objgraph.show.doctor_picture import doctor_picture  # open3d and matplotlib are slow to import

        path = command.out / _PICTURE
        scan = found.scan
        try:
            doctor_picture(scan.frames[found.best], scan.instances, scan.up_world, found.floor, path)
        except OutputError as error:
            return [*found.sections, Section("Picture", findings=(Finding.of(error, str(path)),))]
        console.print(f"written to {path}", markup=False)
    return found.sections


def _lidar(dataset: str, root: Path, command: DoctorCommand, console: Console) -> Iterable[Section]:
    if command.out is not None or command.trajectory is not None or command.topic.options():
        raise DatasetError(
            f"data set '{dataset}': there is no picture of a LiDAR's scan (--out), no --trajectory and no --topic"
        )
    with progress(console, transient=True) as tell:
        return examine_lidar(
            dataset, root, command.scene, lambda done, total: tell("reading frames", done, total)
        )


def _told(sections: Iterable[Section], console: Console) -> int:
    """Print everything, what is wrong last; 1 where anything is."""
    sections = list(sections)
    table = Table(box=SIMPLE_HEAD, show_header=False, padding=(0, 1, 0, 0))
    table.add_column(no_wrap=True)
    table.add_column()
    for section in sections:
        table.add_row(f"[bold]{escape(section.title)}[/]", "")
        for label, value in section.rows:
            table.add_row(f"  {escape(label)}", escape(value))
    console.print(table, highlight=False)
    findings = [finding for section in sections for finding in section.findings]
    for finding in sorted(findings, key=lambda each: not each.note):
        _print_finding(finding, console)
    wrong = sum(len(section.wrong) for section in sections)
    console.print(
        f"[bold red]{wrong} wrong[/]" if wrong else "[bold green]nothing is wrong[/]", highlight=False
    )
    return 1 if wrong else 0


def _print_finding(finding: Finding, console: Console) -> None:
    mark = "note" if finding.note else "[bold red]wrong[/]"
    what = escape(finding.what if finding.where in finding.what else f"{finding.where}: {finding.what}")
    console.print(f"{mark}: {what}", highlight=False, soft_wrap=True)
    if finding.do:
        console.print(f"  [bold]do[/]: {escape(finding.do)}", highlight=False, soft_wrap=True)
