"""What the command line does for active vision: `objgraph next-view`."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import gtsam
import numpy as np
import tyro
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from factors import checks
from objgraph.active.cameras import sphere
from objgraph.active.from_map import targets_from_map
from objgraph.active.next_view import Criterion, NextViewConfig, ViewGain, next_views
from objgraph.active.target import Target
from objgraph.atomic import check_place, write_file
from objgraph.datasets.trajectory import read_tum
from objgraph.errors import ActiveVisionError, ConfigError
from objgraph.maps.object_map import ObjectMap
from objgraph.observation.frames import Intrinsics
from objgraph.priors.store import load_prior_file
from objgraph.show.next_view import LABELS, UNITS, sphere_picture

_DOCUMENT = "next_views.json"


@dataclass(frozen=True)
class NextViewCommand:
    """Which view of a map's objects would tell most, from their covariances alone."""

    map: Annotated[Path, tyro.conf.Positional]
    """A map's folder, or its map.json."""
    objects: tuple[int, ...] = ()
    """Ids of the objects to ask about; by default all that are mapped."""
    candidates: int = 200
    """Cameras on a sphere about each object."""
    distance: float = 1.8
    """Its radius, metres."""
    far: float = NextViewConfig.far
    """Depths beyond this are not measured, metres."""
    elevations: tuple[float, float] = (5.0, 60.0)
    """Lowest and highest angle above the object's middle, degrees."""
    cameras: Path | None = None
    """Candidates of your own in place of the spheres: a trajectory file in the TUM format."""
    criterion: Criterion = "corners"
    """What to gain: surer corners of the box, information on the 9-DoF pose or on everything, or a surer surface."""
    focal: float = 525.0
    """Of the camera, pixels."""
    size: tuple[int, int] = (640, 480)
    """Of its picture, pixels."""
    priors: tuple[Path, ...] = ()
    """Your own priors, where the map was made with them."""
    top: int = 5
    """Views to list."""
    out: Path | None = None
    """Folder for next_views.json and a picture for each object; by default nothing is written."""


def run_next_view(command: NextViewCommand, console: Console) -> list[ViewGain]:
    """Load, rank, show, and write what was asked for.

    Raises:
        ActiveVisionError, MapError, PriorError, DatasetError: the map, a prior or the candidates cannot be used, or no
            candidate sees an object.
        ConfigError: `top` or `far` is no such number.
        OutputError: `out` cannot be written.
    """
    top = checks.whole("--top", command.top, checks.Range(1), ConfigError)
    if command.out is not None:
        check_place(command.out / _DOCUMENT)
    folder = command.map.parent if command.map.suffix == ".json" else command.map
    object_map = ObjectMap.load(folder)
    targets = targets_from_map(
        object_map, command.objects, [load_prior_file(path) for path in command.priors]
    )
    asked = {entry.name for entry in targets}
    others = [
        (entry.vertices, entry.faces)
        for entry in object_map.mapped
        if f"{entry.category} {entry.id}" not in asked
        and entry.vertices is not None
        and entry.faces is not None
    ]
    width, height = command.size
    camera = Intrinsics(command.focal, command.focal, (width - 1) / 2, (height - 1) / 2, width, height)
    config = NextViewConfig(camera, far=command.far)
    with console.status(f"looking at {len(targets)} objects"):
        views = next_views(
            targets, _candidates(command, targets, object_map), config,
            criterion=command.criterion, others=others,
        )  # fmt: skip
    if not any(gain.seen >= config.min_share for view in views for gain in view.objects.values()):
        raise ActiveVisionError(
            f"no candidate sees enough of an object between {config.near:g} and {config.far:g} m: change --distance, "
            "--cameras or --far"
        )
    console.print(_table(views[:top], command.criterion))
    if command.out is not None:
        _write(command, command.out, views, targets, object_map)
        console.print(f"written to {command.out}", markup=False)
    return views


def _candidates(command: NextViewCommand, targets: list[Target], object_map: ObjectMap) -> list[gtsam.Pose3]:
    if command.cameras is not None:
        return [gtsam.Pose3(T) for T in read_tum(command.cameras).T_world_camera]
    return [
        camera
        for entry in targets
        for camera in sphere(
            entry.centre, command.distance, object_map.up_world, command.candidates, command.elevations
        )
    ]


def _table(views: list[ViewGain], criterion: Criterion) -> Table:
    table = Table(title=f"Next views, by {LABELS[criterion]}")
    for label in ("", "camera at, m", "looks along", "gain", "of which"):
        table.add_column(label, justify="right", no_wrap=label != "of which")
    for i, view in enumerate(views):
        T = view.T_world_camera.matrix()
        parts = sorted(view.objects.items(), key=lambda item: -getattr(item[1], criterion))
        of = ", ".join(
            f"{escape(name)} {UNITS[criterion] * getattr(gain, criterion):.3g}"
            for name, gain in parts[:3]
            if gain.seen > 0
        )
        table.add_row(
            str(i + 1),
            _vector(T[:3, 3]),
            _vector(T[:3, 2]),
            f"{UNITS[criterion] * view.total(criterion):.3g}",
            of,
        )
    return table


def _vector(v: np.ndarray) -> str:
    return ", ".join(f"{x:.2f}" for x in v)


def _write(
    command: NextViewCommand,
    out: Path,
    views: list[ViewGain],
    targets: list[Target],
    object_map: ObjectMap,
) -> None:
    criterion = command.criterion
    document: dict[str, Any] = {
        "scene": object_map.scene,
        "criterion": criterion,
        "views": [
            {
                "T_world_camera": view.T_world_camera.matrix().tolist(),
                "gain": view.total(criterion),
                "objects": {name: vars(gain) for name, gain in view.objects.items()},
            }
            for view in views
        ],
    }
    write_file(out / _DOCUMENT, (json.dumps(document, indent=1) + "\n").encode())
    for entry in targets:
        own = sorted(
            _about(entry, views, command), key=lambda view: -getattr(view.objects[entry.name], criterion)
        )
        alone = [ViewGain(view.T_world_camera, {entry.name: view.objects[entry.name]}) for view in own]
        path = out / f"next_view_{entry.name.replace(' ', '_').replace('/', '_')}.png"
        sphere_picture(entry, entry.surface_sigma, alone, object_map.up_world, path, criterion=criterion)


def _about(entry: Target, views: list[ViewGain], command: NextViewCommand) -> list[ViewGain]:
    """The candidates on the object's own sphere; all where the caller gave them."""
    if command.cameras is not None:
        return views
    away = [np.linalg.norm(view.T_world_camera.translation() - entry.centre) for view in views]
    return [
        view for view, distance in zip(views, away, strict=True) if abs(distance - command.distance) < 1e-6
    ]
