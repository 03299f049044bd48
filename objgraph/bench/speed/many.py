"""Maps of many objects: what one takes, and what the map takes in memory and on disk."""

import math
import tempfile
import time
from pathlib import Path

from objgraph.bench.speed import crates
from objgraph.bench.speed.figure import Figure
from objgraph.maps.object_map import ObjectMap
from objgraph.maps.pipeline import MappingConfig, map_scan

CONFIG = MappingConfig(
    views=1,
    mesh_resolution=48,
    sampling=crates.SAMPLING,
    graph=crates.GRAPH,
    initialisation=crates.INITIALISATION,
)


def many_objects(few: int, many: int) -> list[Figure]:
    """Time an object, by how many there are; memory, saving and loading of the larger map."""
    map_scan(crates.scan(2), CONFIG)  # what is loaded first is no object's
    spent: dict[int, list[float]] = {few: [], many: []}
    for count in (few, many, few):
        before = _memory_mb(from_here=True)
        begun = time.process_time()
        found = map_scan(crates.scan(count), CONFIG)
        spent[count].append((time.process_time() - begun) / count)
        if count == many:
            memory, whole = _memory_mb() - before, found
    small = sum(spent[few]) / 2
    rates = [spent[many][0] / each for each in spent[few]]
    size = f"crates, one view each, one process with one thread; {len(whole.mapped)} of {many} mapped"
    return [
        Figure(
            "object_1000_over_10", spent[many][0] / small, min(rates), max(rates), 1.15, "less",
            f"processor time an object, {many} over {few} {size}",
        ),
        Figure("many_mb", memory, memory, memory, 2000.0, "less", f"memory at most, above what there was before, MB; {size}"),
        *_on_disk(whole),
    ]  # fmt: skip


def _on_disk(found: ObjectMap) -> list[Figure]:
    with tempfile.TemporaryDirectory() as folder:
        begun = time.perf_counter()
        found.save(Path(folder) / "map")
        saved = time.perf_counter()
        loaded = ObjectMap.load(Path(folder) / "map")
        ended = time.perf_counter()
    what = f"seconds by the clock; a map of {len(loaded.objects)} crates"
    save, load = saved - begun, ended - saved
    return [
        Figure("save_seconds", save, save, save, 5.0, "less", what),
        Figure("load_seconds", load, load, load, 5.0, "less", what),
    ]


def _memory_mb(from_here: bool = False) -> float:
    """This process's largest memory since the last call that asked for it; NaN where the system does not say."""
    try:
        if from_here:
            Path("/proc/self/clear_refs").write_text("5")
        lines = Path("/proc/self/status").read_text().splitlines()
    except OSError:
        return math.nan
    return next((int(line.split()[1]) / 1024 for line in lines if line.startswith("VmHWM")), math.nan)
