"""The shapes that a prior is trained on: collected meshes, their warped copies, procedural families."""

import logging
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cache, lru_cache, partial
from pathlib import Path

import numpy as np
import trimesh

from factors import checks
from objgraph.atomic import write_file
from objgraph.errors import ConfigError, PriorError
from objgraph.families import FAMILIES, draw
from objgraph.training.meshes.files import MeshError, MeshTimeoutError, canonical, read_mesh
from objgraph.training.meshes.index import HELDOUT_SHARE, CadMesh, NotListedError, heldout_groups, read_index
from objgraph.training.meshes.joined import joined
from objgraph.training.meshes.samples import (
    SampleConfig,
    SdfSamples,
    cache_key,
    load_samples,
    sample_solid,
    save_samples,
)
from objgraph.training.meshes.solid import SOLID_VERSION, Solid, require_depth, require_libraries, solidify
from objgraph.training.meshes.swaps import SWAPPED, swap
from objgraph.training.meshes.warps import random_warp
from objgraph.work import in_order, process_pool

log = logging.getLogger(__name__)

Progress = Callable[[str, int, int], None]
"""Called with what is sampled, how many are done, and how many there are."""


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

    def __post_init__(self) -> None:
        """Raises ConfigError where a number is not one of its kind."""
        checks.settings(self, ConfigError, heldout_share=checks.SHARES, procedural_heldout=checks.Range(1))


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
    category: str,
    meshes: Sequence[Path],
    corpus: CorpusConfig,
    samples: SampleConfig,
    cache: Path,
    jobs: int = 1,
    progress: Progress | None = None,
) -> Corpus:
    """Sample every shape of a category, or read its samples from the cache; in `jobs` processes.

    Raises:
        PriorError: the category has no family, no mesh folder lists it, one cannot be read, the cache cannot be written,
            or the extra `train` is not installed.
    """
    if category not in FAMILIES and not meshes:
        raise PriorError(
            f"category {category!r} has no procedural family ({', '.join(FAMILIES)}): give a folder of meshes"
        )
    if meshes:
        require_libraries()
    parts = []
    with _pool(jobs) as pool:
        make = _Maker(corpus, samples, cache, pool, progress)
        if meshes:
            parts.append(make.collected(listed(meshes, category)))
            if category in SWAPPED:
                parts.append(make.swapped(category, parts[0].used))
        if category in FAMILIES:
            parts.append(make.procedural(category))
    return Corpus(
        training=tuple(shape for part in parts for shape in part.training),
        heldout=tuple(shape for part in parts for shape in part.heldout),
        used=tuple(entry for part in parts for entry in part.used),
        unseen=tuple(entry for part in parts for entry in part.unseen),
        skipped={name: reason for part in parts for name, reason in part.skipped.items()},
    )


def sample_meshes(
    entries: Sequence[CadMesh],
    samples: SampleConfig,
    cache: Path,
    jobs: int = 1,
    progress: Progress | None = None,
) -> list[tuple[CadMesh, SdfSamples]]:
    """Each collected mesh with its samples, or what the cache has of it; what cannot be closed is left out.

    Raises:
        PriorError: the extra `train` is not installed, or a file cannot be written.
    """
    require_libraries()
    corpus = CorpusConfig(copies=0)
    with _pool(jobs) as pool:
        make = _Maker(corpus, samples, cache, pool, progress)
        found = make.each("meshes", entries, [partial(_collected, entry, corpus, False) for entry in entries])
        return [(entry, shapes[0]) for entry, shapes in found if not isinstance(shapes, str)]


def listed(folders: Sequence[Path], category: str) -> list[CadMesh]:
    """What all folders list of a category; one that lists none of it is passed over, if another does.

    Raises:
        PriorError: none lists any, one cannot be read, or meshes of one name are of two groups: a card, which has names alone,
            could not say which of them was held out.
    """
    entries, missing = [], []
    for folder in folders:
        try:
            entries += read_index(folder, category)
        except NotListedError as error:
            missing.append(error)
    if not entries:
        raise missing[0]
    of_name: dict[str, CadMesh] = {}
    for entry in entries:
        if (other := of_name.setdefault(entry.file, entry)).group != entry.group:
            raise PriorError(
                f"{other.path} and {entry.path} have one name and are of two groups: rename one, a prior's card tells meshes by it"
            )
    return entries


def heldout(entries: Sequence[CadMesh], share: float = HELDOUT_SHARE) -> set[str]:
    """Groups held out, of every folder by itself."""
    folders = {entry.folder for entry in entries}
    return {
        group
        for folder in folders
        for group in heldout_groups([entry for entry in entries if entry.folder == folder], share)
    }


@contextmanager
def _pool(jobs: int) -> Iterator[ProcessPoolExecutor | None]:
    if jobs == 1:
        yield None
        return
    with process_pool(jobs, PriorError) as pool:
        yield pool


@dataclass(frozen=True)
class _Maker:
    """Makes the parts of a corpus."""

    corpus: CorpusConfig
    samples: SampleConfig
    cache: Path
    pool: ProcessPoolExecutor | None
    progress: Progress | None

    def collected(self, entries: list[CadMesh]) -> Corpus:
        """Collected meshes with warped copies of those that are trained on; what cannot be closed is left out."""
        held = heldout(entries, self.corpus.heldout_share)
        if self.corpus.validation:
            entries = [entry for entry in entries if entry.group not in held]
            held = heldout(entries, self.corpus.heldout_share)
        shapes: dict[bool, list[SdfSamples]] = {True: [], False: []}
        kept: dict[bool, list[CadMesh]] = {True: [], False: []}
        skipped: dict[str, str] = {}
        works = [partial(_collected, entry, self.corpus, entry.group in held) for entry in entries]
        for entry, found in self.each("meshes", entries, works):
            unseen = entry.group in held
            if isinstance(found, str):
                skipped[entry.file] = found
                continue
            shapes[unseen] += found
            kept[unseen].append(entry)
        return Corpus(
            tuple(shapes[False]), tuple(shapes[True]), tuple(kept[False]), tuple(kept[True]), skipped
        )

    def swapped(self, category: str, entries: tuple[CadMesh, ...]) -> Corpus:
        """Tops of meshes that are trained on, on the bases of others; warped, as their copies are."""
        shapes: list[SdfSamples] = []
        wanted, tried, seed = self.corpus.swaps if len(entries) > 1 else 0, 0, self.corpus.seed
        # about one pair in two does not fit
        while len(shapes) < wanted and tried < 4 * wanted:
            block = range(tried, min(tried + 2 * (wanted - len(shapes)), 4 * wanted))
            works = [partial(_swapped, category, *_pair(entries, seed, i), seed, i) for i in block]
            for found in self._made("swaps", works):
                shapes += [] if isinstance(found, str) else found
            tried = block.stop
        return Corpus(tuple(shapes[:wanted]), heldout=(), used=(), unseen=(), skipped={})

    def procedural(self, category: str) -> Corpus:
        """Procedural meshes, one in `procedural_heldout` of them held out."""
        shapes: dict[bool, list[SdfSamples]] = {True: [], False: []}
        every = self.corpus.procedural_heldout
        drawn = list(draw(category, self.corpus.procedural, self.corpus.seed))
        unseen = [i % every == every - 1 for i in range(len(drawn))]
        works = [
            partial(_procedural, mesh, name, held) for (name, mesh), held in zip(drawn, unseen, strict=True)
        ]
        for held, found in zip(unseen, self._made("families", works), strict=True):
            if isinstance(found, str):
                raise PriorError(found)
            shapes[held] += found
        return Corpus(tuple(shapes[False]), tuple(shapes[True]), used=(), unseen=(), skipped={})

    def each(
        self, words: str, entries: Sequence[CadMesh], works: Sequence["_Work"]
    ) -> Iterator[tuple[CadMesh, "list[SdfSamples] | str"]]:
        """Each mesh with what comes of it; of one that cannot be closed it is said, and why."""
        for entry, found in zip(entries, self._made(words, works), strict=True):
            if isinstance(found, str):
                log.warning("%s is left out: %s", entry.file, found)
            yield entry, found

    def _made(self, words: str, works: Sequence["_Work"]) -> Iterator["list[SdfSamples] | str"]:
        """What comes of each work, in their order; of one that fails, why."""
        tries = [partial(_tried, self.samples, self.cache, work) for work in works]
        results = (one() for one in tries) if self.pool is None else in_order(self.pool, tries)
        for i, result in enumerate(results):
            if self.progress is not None:
                self.progress(words, i + 1, len(works))
            yield result


_Work = Callable[[SampleConfig, Path], list[SdfSamples]]


def _tried(samples: SampleConfig, cache: Path, work: _Work) -> list[SdfSamples] | str:
    try:
        return work(samples, cache)
    except MeshError as error:
        return str(error)


def _collected(
    entry: CadMesh, corpus: CorpusConfig, unseen: bool, samples: SampleConfig, cache: Path
) -> list[SdfSamples]:
    """A collected mesh and its warped copies, or if it is held out points on its surface; MeshError where it is no solid or flat."""
    mesh, seed = read_mesh(entry.path), corpus.seed
    original = lru_cache(maxsize=1)(lambda: _solid(entry, mesh) if unseen else joined(_solid(entry, mesh)))

    def warped(copy: int, key: str) -> Solid:
        if copy == 0:
            return original()
        return original().warped(random_warp(np.random.default_rng([seed, copy, int(key[:8], 16)])))

    shapes = []
    for copy in range(1 if unseen else corpus.copies + 1):
        key = cache_key([mesh], samples, seed, copy, SOLID_VERSION)
        shapes.append(
            _cached(f"{entry.file}#{copy}", key, samples, cache, partial(warped, copy, key), unseen)
        )
        require_depth(shapes[-1].extents, f"mesh {entry.file}")
    return shapes


def _solid(entry: CadMesh, mesh: trimesh.Trimesh) -> Solid:
    """What an entry's mesh, as its file is now, stands for."""
    return _solid_while(entry, hash(mesh))


@cache
def _solid_while(entry: CadMesh, content: int) -> Solid:
    """Remembered as long as the file has this content: samples are kept by what is in it."""
    del content
    return solidify(canonical(read_mesh(entry.path), entry.file), entry.file)


def _pair(entries: Sequence[CadMesh], seed: int, i: int) -> tuple[CadMesh, CadMesh]:
    top, base = np.random.default_rng([seed, i]).choice(len(entries), 2, replace=False)
    return entries[top], entries[base]


def _swapped(
    category: str, top: CadMesh, base: CadMesh, seed: int, i: int, samples: SampleConfig, cache: Path
) -> list[SdfSamples]:
    rng = np.random.default_rng([seed, i, 1])
    upper, lower = read_mesh(top.path), read_mesh(base.path)

    def swapped() -> Solid:
        both = swap(_solid(top, upper), _solid(base, lower), category, rng)
        return joined(both).warped(random_warp(rng))

    key = cache_key([upper, lower], samples, seed, i, SOLID_VERSION)
    return [_cached(f"swap/{top.file}+{base.file}#{i}", key, samples, cache, swapped, measured=False)]


def _procedural(
    mesh: trimesh.Trimesh, name: str, measured: bool, samples: SampleConfig, cache: Path
) -> list[SdfSamples]:
    """Samples of a mesh made of closed parts."""

    def solid() -> Solid:
        return joined(Solid(name, tuple(mesh.split(only_watertight=False))))

    return [_cached(name, cache_key([mesh], samples, SOLID_VERSION), samples, cache, solid, measured)]


def _cached(
    name: str, key: str, config: SampleConfig, cache: Path, solid: Callable[[], Solid], measured: bool
) -> SdfSamples:
    path = cache / f"{key}{'-measured' if measured else ''}.safetensors"
    samples = load_samples(path, name)
    if samples is not None:
        return samples
    refused = cache / f"{key}.refused"  # some take minutes to find out
    if refused.exists():
        raise MeshError(refused.read_text())
    try:
        samples = sample_solid(solid(), config, seed=int(key[:8], 16), measured=measured)
    except MeshTimeoutError:
        raise  # where less else is done it may be closed in time
    except MeshError as error:
        write_file(refused, str(error).encode(), PriorError)
        raise
    samples = replace(samples, name=name)
    save_samples(samples, path)
    return samples
