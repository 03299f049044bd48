"""What may import what, and what the API may load before it is used."""

import ast
import subprocess
import sys
from collections.abc import Iterator
from graphlib import CycleError, TopologicalSorter
from itertools import pairwise
from pathlib import Path
from pkgutil import walk_packages

import pytest

import objgraph

ROOT = Path(objgraph.__file__).parents[1]
API = (
    "objgraph.active.from_map",
    "objgraph.active.next_view",
    "objgraph.datasets.registry",
    "objgraph.graph.object_graph",
    "objgraph.maps.lidar",
    "objgraph.maps.object_map",
    "objgraph.maps.pipeline",
    "objgraph.slam.incremental.object_graph",
    "objgraph.slam.incremental.own_smoother",
)
"""Modules for callers, besides the names in `objgraph.__all__` (not `show`, which draws) and all of `API_FOLDERS`."""
API_FOLDERS = ("covariance", "observation", "priors", "trust")
SLOW = ("matplotlib", "open3d", "scipy.stats", "skimage", "transformers")
CORE = (
    "active",
    "covariance",
    "diagnostics",
    "estimate",
    "geometry",
    "graph",
    "maps",
    "observation",
    "priors",
    "slam",
    "trust",
    "work",
)
AROUND = (
    "bench",
    "cli",
    "datasets",
    "doctor",
    "families",
    "metrics",
    "segment",
    "sensor",
    "show",
    "synthetic",
    "training",
)
"""Folders that use the core and that it must not use."""


def test_the_api_loads_nothing_slow_before_it_is_used():
    folders = [str(ROOT / "objgraph" / folder) for folder in API_FOLDERS]
    found = [
        module.name
        for folder, path in zip(API_FOLDERS, folders, strict=True)
        for module in walk_packages([path], f"objgraph.{folder}.")
    ]
    assert len(found) > len(API_FOLDERS)
    script = f"""
import sys
from importlib import import_module
import objgraph

loaded = {{}}
def note(what):
    for name in {SLOW}:
        if name in sys.modules:
            loaded.setdefault(name, what)

for name in set(objgraph.__all__) - {{"show"}}:
    getattr(objgraph, name)
    note(name)
for module in {[*API, *found]}:
    import_module(module)
    note(module)
sys.exit("\\n".join(f"{{name}} is loaded by {{what}}" for name, what in loaded.items()) or 0)
"""
    run = subprocess.run([sys.executable, "-c", script], cwd=ROOT, capture_output=True, text=True)
    assert run.returncode == 0, run.stderr


def test_the_map_command_loads_no_open3d_before_it_draws():
    script = "import sys, objgraph.cli.map; sys.exit('open3d' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", script], cwd=ROOT, check=False).returncode == 0


def test_folders_import_each_other_in_one_direction():
    places: dict[tuple[str, str], str] = {}
    for path, module in _imports(ROOT / "objgraph"):
        edge = _folder(_own(path)), _folder(module)
        if module.split(".")[0] == "objgraph" and edge[0] != edge[1]:
            places.setdefault(edge, f"{path.relative_to(ROOT)} imports {module}")
    assert len(places) > len(CORE)
    graph: dict[str, set[str]] = {}
    for source, target in places:
        graph.setdefault(source, set()).add(target)
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        cycle = error.args[1][::-1]  # the sorter lists what is imported first
        pytest.fail("a cycle:\n" + "\n".join(places[edge] for edge in pairwise(cycle)))


def test_factors_import_nothing_of_objgraph():
    wrong = [
        f"{path.relative_to(ROOT)} imports {module}"
        for path, module in _imports(ROOT / "factors")
        if module.split(".")[0] == "objgraph"
    ]
    assert not wrong, "\n".join(wrong)


def test_the_core_imports_nothing_that_is_around_it():
    wrong = [
        f"{path.relative_to(ROOT)} imports {module}"
        for folder in CORE
        for path, module in _imports(ROOT / "objgraph" / folder)
        if module.split(".")[0] == "objgraph" and _folder(module) in AROUND
    ]
    assert not wrong, "\n".join(wrong)


def test_every_folder_is_of_the_core_or_around_it():
    folders = {path.parent.name for path in (ROOT / "objgraph").glob("*/__init__.py")}
    assert folders == {*CORE, *AROUND}


def _imports(folder: Path) -> Iterator[tuple[Path, str]]:
    """Every file under a folder with each module, or name in one, that it imports, wherever in the file that is."""
    for path in sorted(folder.rglob("*.py")):
        package = path.relative_to(ROOT).parent.parts
        for node in ast.walk(ast.parse(path.read_text(), str(path))):
            if isinstance(node, ast.Import):
                yield from ((path, alias.name) for alias in node.names)
            elif isinstance(node, ast.ImportFrom):
                above = package[: len(package) + 1 - node.level] if node.level else ()
                module = ".".join([*above, *([node.module] if node.module else [])])
                yield from ((path, f"{module}.{alias.name}") for alias in node.names)


def _own(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(part for part in parts if part != "__init__")


def _folder(module: str) -> str:
    """The folder or file right below `objgraph` that holds a module, or `objgraph` for what its `__init__` names."""
    first = module.split(".")[1:2]
    below = ROOT / "objgraph" / first[0] if first else ROOT
    return first[0] if first and (below.is_dir() or below.with_suffix(".py").exists()) else "objgraph"
