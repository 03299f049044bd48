"""Signed-distance samples of a solid, and their cache."""

import hashlib
import logging
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import trimesh
from jaxtyping import Float
from safetensors import SafetensorError
from safetensors.numpy import load_file, save

from factors import checks
from objgraph.atomic import write_file
from objgraph.errors import ConfigError, PriorError
from objgraph.training.meshes.files import MeshError
from objgraph.training.meshes.solid import SHEET_HALF_THICKNESS, Solid, SolidDistance

log = logging.getLogger(__name__)

SURFACE_POINTS = 20_000
"""Points on the surface of a shape that a decoder is measured against."""


@dataclass(frozen=True)
class SampleConfig:
    """Where a shape's signed distance is sampled. Lengths are in canonical units."""

    count: int = 6000
    """Samples of one shape."""
    near_sigma: float = 0.004
    """Noise about the surface of the nearer share."""
    far_sigma: float = 0.025
    """Noise about the surface of the farther share."""
    near_share: float = 0.40
    """Share of samples at the nearer noise."""
    far_share: float = 0.25
    """Share of samples at the farther noise."""
    box_share: float = 0.20
    """Share of samples that is uniform in the shape's own box, a tenth larger: without them a decoder puts matter between
    legs. What is left is uniform in the cube."""
    half_extent: float = 0.6
    """Half the edge of the cube of uniform samples."""

    def __post_init__(self) -> None:
        """Raises ConfigError where a number is not one of its kind, or the shares are more than all."""
        checks.settings(
            self, ConfigError, count=checks.Range(10), near_sigma=checks.POSITIVE, far_sigma=checks.POSITIVE, near_share=checks.SHARES,
            far_share=checks.SHARES, box_share=checks.SHARES, half_extent=checks.POSITIVE,
        )  # fmt: skip
        if (shares := self.near_share + self.far_share + self.box_share) > 1:
            raise ConfigError(
                f"SampleConfig: the shares near, far and in the box add up to {shares:g}, more than 1"
            )


@dataclass(frozen=True)
class SdfSamples:
    """Samples of one shape's signed distance: unclamped, canonical units, negative inside."""

    name: str
    points: Float[np.ndarray, "n 3"]
    sdf: Float[np.ndarray, "n"]
    extents: Float[np.ndarray, "3"]
    """Edges of the shape's bounding box, whose diagonal is 1."""
    surface: Float[np.ndarray, "m 3"] | None = None
    """Points uniform by area on the outer surface, where the shape is measured against."""


def sample_solid(solid: Solid, config: SampleConfig, seed: int, measured: bool = False) -> SdfSamples:
    """Draw the samples of a solid; `measured` adds points uniform on its surface.

    Raises:
        MeshError: a distance is not finite, or nothing at all is inside; the message names the solid.
    """
    rng = np.random.default_rng(seed)
    distance = SolidDistance(solid)
    near, far = round(config.near_share * config.count), round(config.far_share * config.count)
    surface = surface_points(solid, distance, near + far, rng)
    sigma = np.repeat([config.near_sigma, config.far_sigma], [near, far])[:, None]
    boxed = round(config.box_share * config.count)
    within = 0.55 * solid.extents * rng.uniform(-1, 1, (boxed, 3))
    cube = config.half_extent * rng.uniform(-1, 1, (config.count - near - far - boxed, 3))
    points = np.concatenate([surface + sigma * rng.normal(size=surface.shape), within, cube]).astype(
        np.float32
    )
    sdf = distance(points)
    if not np.isfinite(sdf).all():
        raise MeshError(f"mesh {solid.name}: {np.sum(~np.isfinite(sdf))} signed distances are not finite")
    if not (sdf < 0).any():
        raise MeshError(f"mesh {solid.name}: no sample is inside, its surface is not closed")
    on_it = surface_points(solid, distance, SURFACE_POINTS, rng, area_power=1.0) if measured else None
    return SdfSamples(
        solid.name, points, sdf, solid.extents, None if on_it is None else on_it.astype(np.float32)
    )


def surface_points(
    solid: Solid, distance: SolidDistance, count: int, rng: np.random.Generator, area_power: float = 0.75
) -> Float[np.ndarray, "n 3"]:
    """Points on the solid's outer surface; below an `area_power` of 1 small parts get more than their share."""
    meshes = solid.surfaces
    weights = np.array([mesh.area for mesh in meshes]) ** area_power
    shares = rng.multinomial(2 * count, weights / weights.sum())
    drawn = [
        trimesh.sample.sample_surface(mesh, int(n), seed=rng)[0]
        for mesh, n in zip(meshes, shares, strict=True)
        if n
    ]
    points = np.concatenate(drawn)
    points = points[distance(points) > -SHEET_HALF_THICKNESS - 1e-4]
    if len(points) == 0:
        raise MeshError(f"mesh {solid.name}: none of its surface is on the outside")
    return points[rng.choice(len(points), count, replace=len(points) < count)]


def cache_key(meshes: Sequence[trimesh.Trimesh], config: SampleConfig, *extra: object) -> str:
    """A name for the samples of these meshes under this configuration."""
    digest = hashlib.sha256(repr((sorted(asdict(config).items()), extra)).encode())
    for mesh in meshes:
        digest.update(np.ascontiguousarray(mesh.vertices, np.float64).tobytes())
        digest.update(np.ascontiguousarray(mesh.faces, np.int64).tobytes())
    return digest.hexdigest()[:24]


def save_samples(samples: SdfSamples, path: Path) -> None:
    """Write atomically; raises PriorError where that is impossible."""
    tensors = {"points": samples.points, "sdf": samples.sdf, "extents": samples.extents}
    if samples.surface is not None:
        tensors["surface"] = samples.surface
    write_file(path, save(tensors), PriorError)


def load_samples(path: Path, name: str) -> SdfSamples | None:
    """Cached samples; None where there are none or the file is damaged, so that they are drawn again."""
    if not path.is_file():
        return None
    try:
        tensors = load_file(path)
        return SdfSamples(name, tensors["points"], tensors["sdf"], tensors["extents"], tensors.get("surface"))
    except (SafetensorError, KeyError):
        log.warning("%s is damaged: its samples are drawn again", path)
        return None
