"""What mapping gives: the objects of a scene, saved as JSON, GLB and safetensors."""

import logging
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from factors import checks
from objgraph.errors import MapError
from objgraph.maps import document as map_json
from objgraph.maps import files as map_files
from objgraph.maps.colors import sigma_colors, sigma_limit
from objgraph.maps.mapped_object import MappedObject

log = logging.getLogger(__name__)

VERSION = 7
"""Of the document's layout."""
_NEW = {6: ("trust",)}
"""What objects of earlier layouts that are still read had not."""
_COARSE = 1e-3
"""Metres between neighbouring numbers of single precision from which on a mesh is worth a warning."""


@dataclass(frozen=True, eq=False)
class ObjectMap:
    """The objects of a scene.

    Raises:
        MapError: the scene is no Unicode text, two objects share an id, or `up_world` is no unit vector.
    """

    scene: str
    objects: tuple[MappedObject, ...]
    up_world: Float[np.ndarray, "3"]
    """Unit vector against gravity, world frame."""

    def __post_init__(self) -> None:
        where = f"map of {checks.string('the scene of a map', self.scene, MapError)}"
        up = checks.reals(f"{where}: up_world", self.up_world, (3,), error=MapError)
        if not abs(np.linalg.norm(up) - 1) < 1e-6:
            raise MapError(f"{where}: up_world {up.tolist()} is no unit vector of length 3")
        up.flags.writeable = False
        object.__setattr__(self, "up_world", up)
        objects = checks.tuple_of(f"{where}: objects", self.objects, MappedObject, MapError)
        object.__setattr__(self, "objects", objects)
        ids = [entry.id for entry in self.objects]
        if repeated := sorted({i for i in ids if ids.count(i) > 1}):
            raise MapError(f"map of {self.scene}: several objects have the id {repeated}; give each its own")

    @property
    def mapped(self) -> tuple[MappedObject, ...]:
        """The objects that did not fail."""
        return tuple(entry for entry in self.objects if entry.status == "mapped")

    def save(self, folder: Path | str) -> None:
        """Write `map.json`, and for each object its mesh (GLB, world frame; coloured by sigma, its attribute `_SIGMA`) and its
        joint covariance (safetensors).

        Over an existing map a kill at any moment leaves the old map or the new one. Who reads meanwhile may miss files
        that the old one named. The old one's `evaluation.json` goes. Other files are left alone: `config.json` too, which
        `objgraph map` writes after this, and from which `objgraph report` and `view` know the scan. Vertices and their
        sigma are stored in single precision, which is warned of from 16 km off the origin on.

        Raises:
            MapError: the folder cannot be written.
        """
        folder = _folder(folder)
        limit = sigma_limit(entry.vertex_sigma for entry in self.objects)
        files: dict[str, bytes] = {}
        entries = []
        for entry in self.objects:
            name = joint = None
            if entry.vertices is not None and entry.faces is not None:
                colors = None
                if entry.vertex_sigma is not None and limit is not None:
                    colors = sigma_colors(entry.vertex_sigma, limit)
                _warn_of_coarseness(entry.name, entry.vertices)
                surface = map_files.Surface(entry.vertices, entry.faces, entry.vertex_sigma)
                data = map_files.encode_surface(surface, colors)
                name = map_files.surface_name(entry.id, data)
                files[name] = data
            if entry.joint_covariance is not None:
                data = map_files.encode_covariance(entry.joint_covariance)
                joint = map_files.covariance_name(entry.id, data)
                files[joint] = data
            entries.append(map_json.to_json(entry, name, joint))
        document = {
            "version": VERSION,
            "scene": self.scene,
            "up_world": self.up_world.tolist(),
            "objects": entries,
        }
        map_files.commit(folder, document, files)

    @classmethod
    def load(cls, folder: Path | str) -> "ObjectMap":
        """The map saved in a folder.

        Raises:
            MapError: a file is missing or broken, or a field is; the message names both.
        """
        folder = _folder(folder)
        path = folder / map_files.DOCUMENT
        document = map_files.read_document(folder)
        map_json.require(document, ("version", "scene", "up_world", "objects"), f"{path}")
        version = document["version"]
        if version != VERSION and not (isinstance(version, int) and version in _NEW):
            newer = isinstance(version, int) and version > VERSION
            what = (
                f"newer than {VERSION}, the last that is known here: update objgraph"
                if newer
                else f"not {VERSION}"
            )
            raise MapError(f"{path}: of format {version!r}, {what}")
        if not isinstance(document["objects"], list):
            raise MapError(f"{path}: objects is no list")
        lacking = dict.fromkeys(_NEW.get(version, ()))
        entries = [
            {**lacking, **entry} if isinstance(entry, dict) else entry for entry in document["objects"]
        ]
        objects = [map_json.from_json(entry, i, folder) for i, entry in enumerate(entries)]
        try:
            return cls(str(document["scene"]), tuple(objects), document["up_world"])
        except (MapError, TypeError, ValueError) as error:
            raise MapError(f"{path}: {error}") from error


def _warn_of_coarseness(name: str, vertices: Float[np.ndarray, "v 3"]) -> None:
    farthest = float(min(np.abs(vertices).max(), np.finfo(np.float32).max / 2))
    if (step := float(np.spacing(np.float32(farthest)))) > _COARSE:
        log.warning(
            "%s: %.0f km off the world's origin its mesh is saved in steps of %.0f mm; move the origin near the scan",
            name, farthest / 1000, 1000 * step,
        )  # fmt: skip


def _folder(folder: Path | str) -> Path:
    if not isinstance(folder, (str, Path)):
        raise MapError(f"the folder of a map must be a path, not a {type(folder).__name__}")
    return Path(folder)
