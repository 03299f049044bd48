"""`objgraph map --scenes`: many scans, each into a folder of its own."""

import json
import logging
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from io import StringIO
from pathlib import Path

from rich.console import Console

from factors import checks
from objgraph.cli.map import PICTURE, MapCommand, NothingToMapError, jobs_of, run_map, run_of
from objgraph.cli.progress import progress
from objgraph.cli.run_config import CONFIG, LIDAR_DATASETS, MapRun, root_of
from objgraph.datasets.registry import lidar_frames, scenes
from objgraph.errors import ConfigError, DatasetError, MapError, ObjectGraphError
from objgraph.maps.object_map import ObjectMap
from objgraph.maps.pipeline import MappingConfig
from objgraph.priors.store import load_prior_file
from objgraph.show.report import REPORT
from objgraph.trust.calibration import load_calibration
from objgraph.work import Workers, spread

log = logging.getLogger(__name__)

ALL = "all"


@dataclass(frozen=True)
class _Done:
    """What came of a scan."""

    mapped: int
    objects: int
    seconds: float


def run_map_scenes(command: MapCommand, console: Console) -> None:
    """Map every scan of `command.scenes` that has no page yet; one that fails, or has nothing to be mapped, stops no other.

    Raises:
        DatasetError: the scans cannot be listed, a name is none that a folder can have, or a trajectory is given; or none has
            anything to be mapped.
        MapError: some scans failed, which are named; or a folder holds a map that other settings made.
        ProcessError: there is no Ray cluster.
    """
    run, jobs = run_of(command), checks.whole("--jobs", jobs_of(command), checks.Range(1), ConfigError)
    names = _names(command, run)
    left = [name for name in names if not _is_done(command.out / name, run, name)]
    works = [
        partial(_mapped, replace(command, scene=name, scenes=None, out=command.out / name)) for name in left
    ]
    failed: list[str] = []
    empty: list[str] = []
    with progress(console) as tell:
        tell("mapping scans", len(names) - len(left), len(names))
        found = spread(works, Workers(min(jobs, len(left)), command.engine)) if left else ()
        for count, (place, result) in enumerate(found, len(names) - len(left) + 1):
            if isinstance(result, _Done):
                said = f"{result.mapped} of {result.objects} objects in {result.seconds:.0f} s"
            elif isinstance(result, NothingToMapError):
                empty.append(left[place])
                said = f"left out: {result}"
            else:
                failed.append(left[place])
                said = f"failed: {result}"
            console.print(f"{left[place]}: {said}", markup=False, highlight=False, soft_wrap=True)
            tell("mapping scans", count, len(names))
    mapped = len(names) - len(failed) - len(empty)
    nothing = f", {len(empty)} have nothing to be mapped" if empty else ""
    console.print(
        f"{mapped} of {len(names)} scans are mapped in {command.out}{nothing}", markup=False, soft_wrap=True
    )
    if failed:
        raise MapError(
            f"{len(failed)} of {len(names)} scans failed: {', '.join(failed)}; the same command tries them again"
        )
    if not mapped:
        raise NothingToMapError(f"--scenes {command.scenes}: no scan has anything to be mapped")


def _names(command: MapCommand, run: MapRun) -> Sequence[str]:
    if command.scene is not None:
        raise DatasetError("--scene names one scan, --scenes many: give one of them")
    if run.source.trajectory is not None:
        raise DatasetError(
            f"--scenes maps many scans, and {run.source.trajectory} is one's trajectory: map that one by --scene"
        )
    if command.scenes == ALL:
        dataset, root = run.source.dataset, root_of(run.source)
        listed = lidar_frames if dataset in LIDAR_DATASETS else scenes
        names = listed(dataset, root)
    else:
        assert command.scenes is not None
        try:
            lines = Path(command.scenes).read_text(encoding="utf-8-sig").splitlines()
            names = [line.strip() for line in lines if line.strip()]
        except (OSError, UnicodeError) as error:
            raise DatasetError(
                f"--scenes takes '{ALL}' or a file of names, not {command.scenes} ({error})"
            ) from error
    if not names:
        raise DatasetError(f"--scenes {command.scenes}: there is no scan")
    places = {Path(name): name for name in names}
    if wrong := [
        name for path, name in places.items() if path.is_absolute() or not path.parts or ".." in path.parts
    ]:
        raise DatasetError(f"--scenes: '{wrong[0]}' is no name of a scan that a folder of its own could have")
    return list(places.values())


def _is_done(folder: Path, run: MapRun, name: str) -> bool:
    """Whether its page and, if there is anything to draw, its picture are there, which are written last.

    Raises:
        MapError: other settings made it, or a prior or calibration that was in a file of theirs before.
    """
    if not (folder / REPORT).is_file():
        return False
    try:
        known = json.loads((folder / CONFIG).read_bytes())
        # a page alone may be of `objgraph report` after a stop
        drawn = (folder / PICTURE).is_file() or not ObjectMap.load(folder).mapped
    except (OSError, ValueError):
        return False
    if not drawn or not isinstance(known, dict):
        return False
    wanted = json.loads(replace(run, source=replace(run.source, scene=name)).text())
    other = [key for key in wanted if key != "objgraph" and known.get(key) != wanted[key]]
    if other := other or _made_anew(folder, run):
        raise MapError(f"{folder} holds a map of other {', '.join(other)}: give another --out, or delete it")
    return True


def _made_anew(folder: Path, run: MapRun) -> list[str]:
    """Settings that name a file which is not what it was when the map was made."""
    calibration = run.settings.calibration if isinstance(run.settings, MappingConfig) else ""
    if not run.settings.priors and not calibration:
        return []
    mapped, found = ObjectMap.load(folder).mapped, []
    given = [load_prior_file(Path(path)) for path in run.settings.priors]
    digests = {prior.category: prior.digest for prior in reversed(given)}  # of several the first serves
    used = [each.prior for each in mapped if each.prior is not None]
    if any(digests.get(each.name, each.hash) != each.hash for each in used):
        found.append("priors")
    said = {each.trust.calibration for each in mapped if each.trust is not None}
    if calibration and said - {load_calibration(Path(calibration)).digest}:
        found.append("calibration")
    return found


def _mapped(command: MapCommand) -> _Done | ObjectGraphError:
    """One scan, in whatever process this is; its table goes nowhere, its page is in its folder."""
    begun = time.perf_counter()
    try:
        found = run_map(replace(command, jobs=1, engine="local"), Console(file=StringIO()))
    except ObjectGraphError as error:
        return error
    except Exception as error:  # a full disk, a bug: the other scans are mapped all the same
        log.debug("scan %s", command.scene, exc_info=True)
        return MapError(f"{type(error).__name__}: {error}")
    return _Done(len(found.mapped), len(found.objects), time.perf_counter() - begun)
