"""The shapes that a prior is trained on: collected meshes, their warped copies, procedural families."""

import logging
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from pathlib import Path

import numpy as np
import trimesh

from objgraph.errors import PriorError
from objgraph.training.families import FAMILIES, draw
from objgraph.training.index import HELDOUT_SHARE, CadMesh, heldout_groups, read_index
from objgraph.training.mesh_files import canonical, read_mesh
from objgraph.training.samples import (
    SampleConfig,
    SdfSamples,
    cache_key,
    load_samples,
    sample_solid,
    save_samples,
)
from objgraph.training.solid import SOLID_VERSION, Solid, solidify
from objgraph.training.swaps import SWAPPED, swap
from objgraph.training.warps import random_warp

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class CorpusConfig:
    """Which shapes are drawn, and which of them are held out."""

    procedural: int = 700
    """Procedural meshes a category."""
    copies: int = 5
    """Warped copies of every collected mesh, beside itself."""
    swaps: int = 150
    """Meshes put together from two collected ones, where a category has parts to swap."""
    heldout_share: float = HELDOUT_SHARE
    """Share of the collected meshes that is held out, by groups of near-duplicates."""
    validation: bool = False
    """Leave the held-out meshes out altogether and hold out the next ones in their place: for choosing settings."""
    procedural_heldout: int = 25
    """One procedural mesh in this many is held out."""
    seed: int = 0
    """Seed of families, warps and samples."""


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


def build_corpus(
    category: str, meshes: Path | None, corpus: CorpusConfig, samples: SampleConfig, cache: Path
) -> Corpus:
    """Sample every shape of a category, or read its samples from the cache.

    Raises:
        PriorError: the category has no family, or the mesh folder cannot be read.
    """
    if category not in FAMILIES and meshes is None:
        raise PriorError(
            f"category {category!r} has no procedural family ({', '.join(FAMILIES)}): give a folder of meshes"
        )
    parts = []
    if meshes is not None:
        entries = read_index(meshes, category)
        parts.append(_collected_corpus(meshes, entries, corpus, samples, cache))
        if category in SWAPPED:
            parts.append(_swapped_corpus(category, meshes, parts[0].used, corpus, samples, cache))
    if category in FAMILIES:
        parts.append(_procedural_corpus(category, corpus, samples, cache))
    return Corpus(
        training=tuple(shape for part in parts for shape in part.training),
        heldout=tuple(shape for part in parts for shape in part.heldout),
        used=tuple(entry for part in parts for entry in part.used),
        unseen=tuple(entry for part in parts for entry in part.unseen),
        skipped={name: reason for part in parts for name, reason in part.skipped.items()},
    )


def _collected_corpus(
    folder: Path, entries: list[CadMesh], corpus: CorpusConfig, samples: SampleConfig, cache: Path
) -> Corpus:
    """Collected meshes with warped copies of those that are trained on; what cannot be closed is left out."""
    held = heldout_groups(entries, corpus.heldout_share)
    if corpus.validation:
        entries = [entry for entry in entries if entry.group not in held]
        held = heldout_groups(entries, corpus.heldout_share)
    shapes: dict[bool, list[SdfSamples]] = {True: [], False: []}
    kept: dict[bool, list[CadMesh]] = {True: [], False: []}
    skipped: dict[str, str] = {}
    for entry in entries:
        unseen = entry.group in held
        copies = 0 if unseen else corpus.copies
        try:
            shapes[unseen] += _collected(
                folder / entry.file, entry.file, copies, corpus.seed, samples, cache, unseen
            )
            kept[unseen].append(entry)
        except PriorError as error:
            skipped[entry.file] = str(error)
            log.warning("%s is left out: %s", entry.file, error)
    return Corpus(tuple(shapes[False]), tuple(shapes[True]), tuple(kept[False]), tuple(kept[True]), skipped)


def _swapped_corpus(
    category: str,
    folder: Path,
    entries: tuple[CadMesh, ...],
    corpus: CorpusConfig,
    samples: SampleConfig,
    cache: Path,
) -> Corpus:
    """Tops of meshes that are trained on, on the bases of others; warped, as their copies are."""
    solid = lru_cache(maxsize=None)(lambda file: _solid(folder / file, file))
    files = [entry.file for entry in entries]
    shapes: list[SdfSamples] = []
    # about one pair in two does not fit
    for i in range(4 * corpus.swaps):
        if len(shapes) == corpus.swaps or len(files) < 2:
            break
        rng = np.random.default_rng([corpus.seed, i])
        top, base = rng.choice(files, 2, replace=False)

        def swapped(top: str = top, base: str = base, rng: np.random.Generator = rng) -> Solid:
            return swap(solid(top), solid(base), category, rng).warped(random_warp(rng))

        key = cache_key(
            [read_mesh(folder / top), read_mesh(folder / base)], samples, corpus.seed, i, SOLID_VERSION
        )
        refused = cache / f"{key}.refused"
        if refused.exists():
            continue
        try:
            shapes.append(_cached(f"swap/{top}+{base}#{i}", key, samples, cache, swapped, measured=False))
        except PriorError as error:
            log.info("no swap: %s", error)
            cache.mkdir(parents=True, exist_ok=True)
            refused.touch()
    return Corpus(tuple(shapes), heldout=(), used=(), unseen=(), skipped={})


def _procedural_corpus(category: str, corpus: CorpusConfig, samples: SampleConfig, cache: Path) -> Corpus:
    """Procedural meshes, one in `procedural_heldout` of them held out."""
    shapes: dict[bool, list[SdfSamples]] = {True: [], False: []}
    for i, (name, mesh) in enumerate(draw(category, corpus.procedural, corpus.seed)):
        unseen = i % corpus.procedural_heldout == corpus.procedural_heldout - 1
        shapes[unseen].append(_procedural(mesh, name, samples, cache, unseen))
    return Corpus(tuple(shapes[False]), tuple(shapes[True]), used=(), unseen=(), skipped={})


def _collected(
    path: Path, name: str, copies: int, seed: int, samples: SampleConfig, cache: Path, measured: bool
) -> list[SdfSamples]:
    """A collected mesh and its warped copies; `measured` adds points on the surface."""
    mesh = read_mesh(path)
    original = lru_cache(maxsize=1)(lambda: _solid(path, name))

    def warped(copy: int, key: str) -> Solid:
        if copy == 0:
            return original()
        return original().warped(random_warp(np.random.default_rng([seed, copy, int(key[:8], 16)])))

    shapes = []
    for copy in range(copies + 1):
        key = cache_key([mesh], samples, seed, copy, SOLID_VERSION)
        shapes.append(_cached(f"{name}#{copy}", key, samples, cache, partial(warped, copy, key), measured))
    return shapes


def _solid(path: Path, name: str) -> Solid:
    return solidify(canonical(read_mesh(path), name), name)


def _procedural(
    mesh: trimesh.Trimesh, name: str, samples: SampleConfig, cache: Path, measured: bool
) -> SdfSamples:
    """Samples of a mesh made of closed parts."""

    def solid() -> Solid:
        return Solid(name, tuple(mesh.split(only_watertight=False)))

    return _cached(name, cache_key([mesh], samples), samples, cache, solid, measured)


def _cached(
    name: str, key: str, config: SampleConfig, cache: Path, solid: Callable[[], Solid], measured: bool
) -> SdfSamples:
    path = cache / f"{key}{'-measured' if measured else ''}.safetensors"
    samples = load_samples(path, name)
    if samples is None:
        samples = sample_solid(solid(), config, seed=int(key[:8], 16), measured=measured)
        samples = replace(samples, name=name)
        save_samples(samples, path)
    return samples
