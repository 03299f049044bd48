"""What a user imports: two names, each with a short list of others, loaded when they are asked for."""

import ast
import inspect
import subprocess
import sys
from types import ModuleType

import pytest

import factors
import objgraph
from tests.conftest import REPOSITORY


def typed_names(module: ModuleType) -> set[str]:
    """Names that a type checker is told of."""
    guard = next(node for node in ast.parse(inspect.getsource(module)).body if isinstance(node, ast.If))
    return {alias.name for node in guard.body if isinstance(node, ast.ImportFrom) for alias in node.names}


@pytest.mark.parametrize("module", [objgraph, factors], ids=lambda module: module.__name__)
def test_names_are_there_and_type_checkers_know_the_same(module: ModuleType):
    assert typed_names(module) == set(module.__all__)
    for name in module.__all__:
        assert getattr(module, name) is not None
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = module.nothing


def test_the_list_is_short():
    rooms = {name for name in objgraph.__all__ if isinstance(getattr(objgraph, name), ModuleType)}
    assert rooms == {"active", "covariance", "datasets", "maps", "observation", "show", "slam", "trust"}
    assert len(set(objgraph.__all__) - rooms) <= 32


@pytest.mark.parametrize(
    "room", ["active", "covariance", "datasets", "maps", "observation", "show", "slam", "trust"]
)
def test_a_room_has_what_it_says(room: str):
    module = getattr(objgraph, room)
    assert module.__all__
    for name in module.__all__:
        assert getattr(module, name) is not None


def test_importing_the_package_loads_nothing_heavy():
    code = "import sys, objgraph, factors; print(*(m for m in ('torch', 'gtsam', 'scipy', 'cv2') if m in sys.modules))"
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=REPOSITORY, capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == ""
