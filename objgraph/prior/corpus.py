"""The shapes that a prior is trained on: collected meshes, their warped copies, procedural families."""

import hashlib
import json
import logging
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import trimesh

from objgraph.errors import PriorError
from objgraph.prior.families import FAMILIES, draw
from objgraph.prior.samples import SampleConfig, SdfSamples, cache_key, load_samples, sample_solid, save_samples
from objgraph.prior.solid import Solid, solidify
from objgraph.prior.warps import random_warp

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class CorpusConfig:
    """Which shapes are drawn, and which of them are held out."""

    procedural: int = 500
    """Procedural meshes a category."""
    copies: int = 3
    """Warped copies of every collected mesh, beside itself."""
    heldout_share: float = 0.2
    """Share of the collected meshes that is held out, by groups of near-duplicates."""
    procedural_heldout: int = 25
    """One procedural mesh in this many is held out."""
    seed: int = 0
    """Seed of families, warps and samples."""


@dataclass(frozen=True)
class CadMesh:
    """A collected mesh's entry in `index.json`."""

    file: str
    group: str
    licence: str
    attribution: str
    source: str
    size: tuple[float, float, float] | None
    """Metric extents where the source has them."""


@dataclass(frozen=True)
class Corpus:
    """Training and held-out samples, and what became of the collected meshes."""

    training: tuple[SdfSamples, ...]
    heldout: tuple[SdfSamples, ...]
    used: tuple[CadMesh, ...]
    """Collected meshes trained on."""
    unseen: tuple[CadMesh, ...]
    """Collected meshes held out."""
    skipped: dict[str, str]
    """Meshes left out, and why."""


def read_index(folder: Path, category: str) -> list[CadMesh]:
    """The entries of a category in a folder's `index.json`.

    Raises:
        PriorError: it is missing, damaged or has no mesh of the category; the message names it.
    """
    path = folder / "index.json"
    try:
        entries = json.loads(path.read_text())["meshes"]
        meshes = [
            CadMesh(
                file=entry["file"],
                group=entry["group"],
                licence=entry["licence"],
                attribution=entry["attribution"],
                source=entry["source_repo"],
                size=None if entry["size_m"] is None else tuple(entry["size_m"]),
            )
            for entry in entries
            if entry["category"] == category
        ]
    except OSError as error:
        raise PriorError(f"{path} cannot be read: give the folder that holds index.json") from error
    except (ValueError, KeyError, TypeError) as error:
        raise PriorError(f"{path} is no mesh index: {error!r}") from error
    if not meshes:
        raise PriorError(f"{path} has no mesh of category {category!r}")
    return meshes


def heldout_groups(meshes: list[CadMesh], share: float) -> set[str]:
    """Groups held out: in an order that only their names decide, until they hold the share of the meshes."""
    groups: dict[str, int] = {}
    for mesh in meshes:
        groups[mesh.group] = groups.get(mesh.group, 0) + 1
    ordered = sorted(groups, key=lambda group: hashlib.sha256(group.encode()).hexdigest())
    chosen: set[str] = set()
    count = 0
    for group in ordered:
        if count >= share * len(meshes):
            break
        chosen.add(group)
        count += groups[group]
    return chosen


def build_corpus(
    category: str, meshes: Path | None, corpus: CorpusConfig, samples: SampleConfig, cache: Path
) -> Corpus:
    """Sample every shape of a category, or read its samples from the cache.

    Raises:
        PriorError: the category has no family, or the mesh folder cannot be read.
    """
    if category not in FAMILIES and meshes is None:
        raise PriorError(f"category {category!r} has no procedural family ({', '.join(FAMILIES)}): give meshes")
    training: list[SdfSamples] = []
    heldout: list[SdfSamples] = []
    skipped: dict[str, str] = {}
    entries = [] if meshes is None else read_index(meshes, category)
    unseen = heldout_groups(entries, corpus.heldout_share)
    for entry in entries:
        held = entry.group in unseen
        try:
            drawn = list(_collected(meshes / entry.file, entry.file, 0 if held else corpus.copies, corpus, samples, cache))  # pyright: ignore
        except PriorError as error:
            skipped[entry.file] = str(error)
            log.warning("%s is left out: %s", entry.file, error)
            continue
        (heldout if held else training).extend(drawn)
    if category in FAMILIES:
        for i, (name, mesh) in enumerate(draw(category, corpus.procedural, corpus.seed)):
            shape = _procedural(mesh, name, samples, cache)
            (heldout if i % corpus.procedural_heldout == corpus.procedural_heldout - 1 else training).append(shape)
    kept = [entry for entry in entries if entry.file not in skipped]
    return Corpus(
        tuple(training),
        tuple(heldout),
        tuple(entry for entry in kept if entry.group not in unseen),
        tuple(entry for entry in kept if entry.group in unseen),
        skipped,
    )


def _collected(
    path: Path, name: str, copies: int, corpus: CorpusConfig, samples: SampleConfig, cache: Path
) -> Iterator[SdfSamples]:
    """A collected mesh and its warped copies."""
    try:
        mesh = trimesh.load_mesh(path, process=False)
    except (OSError, ValueError, IndexError, KeyError) as error:
        raise PriorError(f"{path} cannot be read as a mesh: {error!r}") from error
    solid: Solid | None = None
    for copy in range(copies + 1):
        key = cache_key([mesh], samples, corpus.seed, copy)

        def warped(copy: int = copy) -> Solid:
            nonlocal solid
            solid = solid or solidify(mesh, name)
            if copy == 0:
                return solid
            return solid.warped(random_warp(np.random.default_rng([corpus.seed, copy, int(key[:8], 16)])))

        yield _cached(f"{name}#{copy}", key, samples, cache, warped)


def _procedural(mesh: trimesh.Trimesh, name: str, samples: SampleConfig, cache: Path) -> SdfSamples:
    """Samples of a mesh made of closed parts."""
    return _cached(
        name, cache_key([mesh], samples), samples, cache, lambda: Solid(name, tuple(mesh.split(only_watertight=False)))
    )


def _cached(
    name: str, key: str, config: SampleConfig, cache: Path, solid: Callable[[], Solid]
) -> SdfSamples:
    path = cache / f"{key}.safetensors"
    samples = load_samples(path, name)
    if samples is None:
        samples = sample_solid(solid(), config, seed=int(key[:8], 16))
        samples = SdfSamples(name, samples.points, samples.sdf)
        save_samples(samples, path)
    return samples
