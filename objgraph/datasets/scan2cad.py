"""Scan2CAD's annotations: which CAD model stands where in a scan. Ground truth, for evaluation alone.

Avetisyan et al., "Scan2CAD", CVPR 2019. A CAD model's vertices go to the scan's frame by
`inv(M(trs of the scan)) M(trs of the model)` with `M = T R S`; the annotations' `bbox` and `center` describe
the CAD's bounding box (half extents, middle) and take no part in it, because ShapeNet's meshes are not
centred on their boxes.
"""

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
import trimesh.sample
from jaxtyping import Float
from scipy.optimize import linear_sum_assignment
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from objgraph.checked import inside, numbers
from objgraph.datasets.files import read_bytes, read_json
from objgraph.datasets.ground_truth import GroundTruth
from objgraph.errors import DatasetError
from objgraph.geometry.frames import transformed
from objgraph.geometry.mesh_data import parse_mesh
from objgraph.priors.categories import category_of

log = logging.getLogger(__name__)

SYMMETRIES = {
    "__SYM_NONE": 1,
    "__SYM_ROTATE_UP_2": 2,
    "__SYM_ROTATE_UP_4": 4,
    "__SYM_ROTATE_UP_INF": 0,
}
"""Scan2CAD's symmetry classes as `GroundTruth.symmetry` counts them."""

_MATCH_DISTANCE = 0.1
_MATCH_SHARE = 0.3
_MATCH_POINTS = 2000


@dataclass(frozen=True)
class AlignedModel:
    """One annotated CAD model of a scan."""

    truth: GroundTruth
    category: str
    """This project's name of the CAD's category, or ShapeNet's id where it has none."""


def load_aligned_models(annotations: Path, shapenet: Path, scene: str) -> list[AlignedModel]:
    """The annotated models of `scene`, in the file's order; empty, and logged, where the file or scene is missing.

    `shapenet` holds `ShapeNetCore.v2/` or is that folder. Raises `DatasetError` for a malformed annotation or
    a mesh that is missing or unreadable.
    """
    if not annotations.is_file():
        log.info("%s: not there, so no ground truth for %s", annotations, scene)
        return []
    entries = [entry for entry in _entries(annotations) if entry.get("id_scan") == scene]
    if not entries:
        log.info("%s: has no entry for %s, so no ground truth", annotations, scene)
        return []
    core = shapenet / "ShapeNetCore.v2"
    core = core if core.is_dir() else shapenet
    models, listed = [], entries[0].get("aligned_models", [])
    if not isinstance(listed, list):
        raise DatasetError(f"{annotations}: {scene}: aligned_models is no list; download the file again")
    for index, model in enumerate(listed):
        origin = f"{annotations}: {scene}, aligned model {index}"
        try:
            models.append(_aligned_model(entries[0]["trs"], model, core, origin))
        except (KeyError, TypeError, ValueError) as error:
            if isinstance(error, DatasetError):
                raise
            raise DatasetError(f"{origin}: malformed ({type(error).__name__}: {error})") from error
    return models


def match_models(
    models: Sequence[AlignedModel],
    points: Mapping[int, Float[np.ndarray, "n 3"]],
    categories: Mapping[int, str],
) -> dict[int, GroundTruth]:
    """Which annotated model each instance is: Scan2CAD does not say ScanNet's object ids.

    `points` are some of each instance's surface points in the world frame. An instance goes to the model of
    its own category on whose surface (within 10 cm) the largest share of its points lies, each model to one
    instance at most, so that the sum of the shares is largest; shares below 0.3 are no match. Instances
    without a model are not in the result.
    """
    ids = [i for i in categories if len(points.get(i, ())) > 0]
    share = np.zeros((len(ids), len(models)))
    for column, model in enumerate(models):
        rows = [row for row, i in enumerate(ids) if categories[i] == model.category]
        surface = cKDTree(_surface_points(model.truth))
        for row in rows:
            distance, _ = surface.query(points[ids[row]], distance_upper_bound=_MATCH_DISTANCE)
            share[row, column] = np.isfinite(distance).mean()
    pairs = zip(*linear_sum_assignment(share, maximize=True), strict=True)
    return {ids[row]: models[column].truth for row, column in pairs if share[row, column] >= _MATCH_SHARE}


def _surface_points(truth: GroundTruth) -> Float[np.ndarray, "n 3"]:
    """Points on the model's surface in the world frame, evenly spread over its area."""
    vertices = transformed(truth.T_world_object, truth.vertices * truth.scale)
    mesh = trimesh.Trimesh(vertices, truth.faces, process=False)
    return trimesh.sample.sample_surface(mesh, _MATCH_POINTS, seed=0)[0]


def _entries(annotations: Path) -> list[dict[str, Any]]:
    content = read_json(annotations)
    if not isinstance(content, list) or not all(isinstance(entry, dict) for entry in content):
        raise DatasetError(f"{annotations}: a list of scans was expected (Scan2CAD's full_annotations.json)")
    return content


def _aligned_model(scan_trs: Any, model: dict[str, Any], core: Path, origin: str) -> AlignedModel:
    scan, scan_scale = _rigid(scan_trs)
    pose, scale = _rigid(model["trs"])
    if np.ptp(scan_scale) > 1e-6 * scan_scale.max():
        # an anisotropic scan scale would shear the model: no rotation times scale describes that
        raise DatasetError(f"{origin}: the scan's own scale {scan_scale} is not the same on every axis")
    pose[:3, 3] /= scan_scale[0]
    scan[:3, 3] /= scan_scale[0]
    symmetry = str(model.get("sym", "__SYM_NONE"))
    if symmetry not in SYMMETRIES:
        raise DatasetError(f"{origin}: unknown symmetry '{symmetry}'; known: {', '.join(SYMMETRIES)}")
    catalog = str(model["catid_cad"])
    mesh = _read_mesh(inside(core, f"{catalog}/{model['id_cad']}/models/model_normalized.obj"))
    truth = GroundTruth(
        T_world_object=np.linalg.inv(scan) @ pose,
        scale=scale / scan_scale[0],
        vertices=np.asarray(mesh.vertices, dtype=float),
        faces=np.asarray(mesh.faces),
        symmetry=SYMMETRIES[symmetry],
    )
    return AlignedModel(truth, category_of(catalog))


def _rigid(trs: Any) -> tuple[Float[np.ndarray, "4 4"], Float[np.ndarray, "3"]]:
    """Rigid transform and scale of Scan2CAD's `trs`, whose quaternion is w, x, y, z."""
    scale = numbers(trs["scale"], 3)
    if not (scale > 0).all():
        raise ValueError(f"scale {scale} must be positive")
    transform = np.eye(4)
    transform[:3, :3] = Rotation.from_quat(numbers(trs["rotation"], 4), scalar_first=True).as_matrix()
    transform[:3, 3] = numbers(trs["translation"], 3)
    return transform, scale


def _read_mesh(path: Path) -> trimesh.Trimesh:
    """Geometry alone: a missing material file or texture does not matter."""
    if not path.is_file():
        raise DatasetError(f"{path}: missing; ground truth needs ShapeNetCore.v2 with this CAD model")
    try:
        return parse_mesh(read_bytes(path), "obj")
    except ValueError as error:
        if isinstance(error, DatasetError):
            raise
        raise DatasetError(f"{path}: no readable mesh: {error}") from error
