"""What a user waits for: the sample's map and its memory, the start of the program, what a second core gives."""

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from objgraph.bench.speed.figure import Figure, ratio
from objgraph.datasets import scannet
from objgraph.errors import EvaluationError
from objgraph.synthetic.sample import SampleConfig, ensure_sample
from objgraph.synthetic.scene import RoomConfig

_LARGE = SampleConfig(room=RoomConfig(chairs=8, tables=4, size_m=(7.5, 7.0)))
"""A room with objects enough that starting a process is little of it."""


_MAPPED = """
import sys, time
from pathlib import Path
from objgraph.datasets import scannet
from objgraph.maps.pipeline import map_scan
if __name__ == "__main__":
    scan, begun = scannet.load(Path(sys.argv[1])), time.perf_counter()
    map_scan(scan, jobs=int(sys.argv[2]))
    print(time.perf_counter() - begun)
"""
"""A process whose own processes are begun for the first time."""
_BETWEEN = """
import resource, subprocess, sys
status = subprocess.call(sys.argv[1:], stdout=subprocess.DEVNULL)
print(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss)
sys.exit(status)
"""
"""A small process that starts a command: one that was large would leave its own memory to what it starts."""


def whole_commands(root: Path, repeats: int) -> list[Figure]:
    """Seconds by the clock and megabytes of commands in processes of their own.

    Raises EvaluationError where one fails.
    """
    cores, start, demo, one = min(os.cpu_count() or 1, 4), [], [], []
    sample = ["map", "--dataset", "sample", "--root", str(root)]
    with tempfile.TemporaryDirectory() as folder:
        for k in range(repeats):
            start.append(_run(["map", "--help"])[0])
            demo.append(_run([*sample, "--jobs", str(cores), "--out", f"{folder}/{k}"])[0])
            one.append(_run([*sample, "--jobs", "1", "--out", f"{folder}/one{k}"])[1])
    what = f"medians of {repeats}; `objgraph map --dataset sample`, the scan being there"
    return [
        _figure("demo_seconds", demo, 60.0, f"seconds by the clock, {cores} processes; {what}"),
        _figure(
            "start_seconds",
            start,
            None,
            f"seconds by the clock of `objgraph map --help`, median of {repeats}",
        ),
        _figure("peak_mb", one, None, f"MB, one process; {what}"),
    ]


def two_cores(root: Path, repeats: int) -> Figure:
    """How much faster two processes map a large room than one, starts counted; raises EvaluationError on one core."""
    if (os.cpu_count() or 1) < 2:
        raise EvaluationError("there is one core: what a second gives cannot be measured")
    folder = ensure_sample(root, _LARGE) / "scannet"
    spent: dict[int, list[float]] = {1: [], 2: []}
    for _ in range(repeats):
        for jobs, seconds in spent.items():
            command = [sys.executable, "-c", _MAPPED, str(folder), str(jobs)]
            done = subprocess.run(command, capture_output=True, text=True)
            if done.returncode:
                raise EvaluationError(f"mapping {folder} failed: {done.stderr.strip()[-300:]}")
            seconds.append(float(done.stdout))
    what = (
        f"by the clock, two processes and one in turns, their start counted, {repeats} repeats; "
        f"{len(scannet.load(folder).instances)} objects of a room"
    )
    return ratio("two_cores_over_one", spent[1], spent[2], 1.7, what, better="more")


def _run(arguments: list[str]) -> tuple[float, float]:
    """Seconds, and megabytes of its largest process."""
    begun = time.perf_counter()
    command = [sys.executable, "-m", "objgraph.cli", "-q", *arguments]
    done = subprocess.run([sys.executable, "-S", "-c", _BETWEEN, *command], capture_output=True, text=True)
    seconds = time.perf_counter() - begun
    if done.returncode:
        raise EvaluationError(f"objgraph {' '.join(arguments)} failed: {done.stderr.strip()[-300:]}")
    return seconds, float(done.stdout) / 1024


def _figure(name: str, found: list[float], aim: float | None, what: str) -> Figure:
    return Figure(name, float(np.median(found)), min(found), max(found), aim, "less", what)
