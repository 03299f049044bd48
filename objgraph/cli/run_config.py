"""`config.json`: all that a mapping run depends on, written beside the map and read again by `--config`."""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any, TypeVar

import dacite

from factors import checks
from objgraph.atomic import write_file
from objgraph.checked import parse_json
from objgraph.errors import ConfigError, DatasetError, MapError
from objgraph.maps.lidar import LidarMappingConfig
from objgraph.maps.pipeline import MappingConfig
from objgraph.version import program_version

CONFIG = "config.json"
LIDAR_DATASETS = ("kitti", "lidar", "street")
GENERATED = ("sample", "street")
SAMPLE_ROOT = Path("out/sample")
"""Where the sample scan is generated unless `--root` says otherwise."""
_JSON = (str, int, float, dict, tuple, type(None))
_PROGRAM, _SETTINGS = "objgraph", "settings"

T = TypeVar("T")


@dataclass(frozen=True)
class Topics:
    """Topics of a bag, and the frame that its poses are in; empty for a guess by type and name."""

    depth: str = ""
    """Depth images."""
    color: str = ""
    """Colour images; `none` for none."""
    info: str = ""
    """The camera, of colour where depth is registered to it."""
    pose: str = ""
    """tf, odometry, or poses of the camera."""
    world: str = ""
    """The world's frame."""

    def options(self) -> dict[str, Any]:
        """Those given, as the loader calls them."""
        named = {f"{name}_topic": value for name, value in vars(self).items() if name != "world"}
        return {name: value for name, value in {**named, "world_frame": self.world}.items() if value}


@dataclass(frozen=True)
class Source:
    """Which objects are mapped; paths are as the user gave them."""

    dataset: str
    root: Path | None = None
    scene: str | None = None
    categories: tuple[str, ...] = ()
    trajectory: Path | None = None
    scan2cad: Path | None = None
    shapenet: Path | None = None
    topic: Topics = Topics()


def root_of(source: Source) -> Path:
    """The data set's folder; those that the project generates need none to be named. Raises DatasetError."""
    if source.root is not None:
        return source.root
    if source.dataset not in GENERATED:
        raise DatasetError(f"data set '{source.dataset}': --root must name its folder")
    return SAMPLE_ROOT


@dataclass(frozen=True)
class MapRun:
    """A mapping run."""

    source: Source
    settings: MappingConfig | LidarMappingConfig
    """The latter for the scans of a LiDAR."""

    def save(self, folder: Path) -> None:
        """Write `config.json` at once; raises MapError."""
        write_file(folder / CONFIG, self.text().encode(), MapError)

    def text(self) -> str:
        """What `config.json` holds."""
        document = {_PROGRAM: program_version(), **asdict(self.source), _SETTINGS: asdict(self.settings)}
        return json.dumps(document, indent=2, default=str) + "\n"


def read_run(
    path: Path | None, source: Mapping[str, Any], settings: Mapping[str, tuple[tuple[str, ...], Any]]
) -> MapRun:
    """The run that a file describes, where there is one, with what was typed in place of what it says.

    `source` are typed fields of `Source`, of its topics a mapping; `settings` are typed settings by option: paths that
    one may have, the first that the data set knows counts, and the value.

    Raises:
        ConfigError: the file cannot be read, or holds what is no setting or no value of one; or a path is no Unicode text.
        DatasetError: no data set is named, or it does not use a setting.
    """
    where = "the settings" if path is None else str(path)
    given = {} if path is None else _read(path)
    given.pop(_PROGRAM, None)  # who wrote it changes nothing
    known = given.pop(_SETTINGS, {})
    dataset = source.get("dataset", given.get("dataset"))
    if dataset is None:
        raise DatasetError("no data set: --dataset must name one, or a --config file that does")
    lidar = dataset in LIDAR_DATASETS
    defaults: MappingConfig | LidarMappingConfig = LidarMappingConfig() if lidar else MappingConfig()
    merged = _merged(asdict(defaults), known, f"{where}: {_SETTINGS}", f" of data set '{dataset}'")
    for option, (paths, value) in settings.items():
        if not any(_put(merged, way.split("."), value, f"{where}: {_SETTINGS}") for way in paths):
            raise DatasetError(
                f"data set '{dataset}' does not use {option}; its settings are {', '.join(merged)} (--config)"
            )
    blank = {field.name: None for field in fields(Source)} | {"categories": (), "topic": asdict(Topics())}
    place = _merged(_merged(blank, given, where), source, where)
    return MapRun(_built(Source, place, where), _built(type(defaults), merged, f"{where}: {_SETTINGS}"))


def _read(path: Path) -> dict[str, Any]:
    try:
        document = parse_json(path.read_bytes())
    except (OSError, ValueError) as error:
        raise ConfigError(f"{path}: not a readable JSON file ({error})") from error
    if not isinstance(document, dict):
        raise ConfigError(
            f"{path}: holds a {type(document).__name__} where an object of settings was expected"
        )
    return _with_tuples(document)


def _with_tuples(value: Any) -> Any:
    """JSON has lists where settings have tuples."""
    if isinstance(value, dict):
        return {name: _with_tuples(item) for name, item in value.items()}
    return tuple(map(_with_tuples, value)) if isinstance(value, list) else value


def _merged(default: Mapping[str, Any], given: Any, where: str, of: str = "") -> dict[str, Any]:
    """The default with what is given; a part that is given in part keeps the rest of its own default."""
    if not isinstance(given, Mapping):
        raise ConfigError(f"{where}: an object of settings was expected, not {json.dumps(given)}")
    if unknown := sorted(set(given) - set(default)):
        raise ConfigError(f"{where}: no setting {', '.join(unknown)}{of}; there are {', '.join(default)}")
    inner = {
        name
        for name, value in given.items()
        if isinstance(value, Mapping) and isinstance(default[name], Mapping)
    }
    deeper = {name: _merged(default[name], given[name], f"{where}.{name}", of) for name in inner}
    return {**default, **given, **deeper}


def _put(settings: dict[str, Any], path: list[str], value: Any, where: str) -> bool:
    """Set what lies at a path; False where there is no such setting."""
    *groups, name = path
    for group in groups:
        settings = settings.get(group, {})
        if not isinstance(settings, dict):
            raise ConfigError(
                f"{where}.{group}: an object of settings was expected, not {json.dumps(settings)}"
            )
    if name not in settings:
        return False
    settings[name] = value
    return True


def _built(kind: type[T], document: Mapping[str, Any], where: str) -> T:
    hooks = {float: _as_float, int: _as_int, str: _as_text, Path: _as_path}
    try:
        return dacite.from_dict(kind, document, dacite.Config(strict=True, type_hooks=hooks))
    except dacite.WrongTypeError as error:
        value = f", not {json.dumps(error.value)}" if isinstance(error.value, _JSON) else ""
        raise ConfigError(f"{where}: {error.field_path} must be {_words(error.field_type)}{value}") from error
    except (dacite.DaciteError, ValueError) as error:  # of its type, and yet a value that none may have
        raise ConfigError(f"{where}: {error}") from error


def _as_float(value: Any) -> Any:
    """JSON writes 3.0 as 3."""
    return float(value) if isinstance(value, int) and not isinstance(value, bool) else value


def _as_int(value: Any) -> Any:
    if isinstance(value, bool):  # which Python takes for a number
        raise dacite.WrongTypeError(int, value)
    return value


def _as_text(value: Any) -> Any:
    return checks.string("the name", value, ConfigError) if isinstance(value, str) else value


def _as_path(value: Any) -> Any:
    return Path(_as_text(str(value))) if isinstance(value, (str, Path)) else value


def _words(kind: Any) -> str:
    return kind.__name__ if isinstance(kind, type) else str(kind).replace("typing.", "")
