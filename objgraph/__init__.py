"""Object-level mapping with learnt shape priors, as a factor graph."""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from objgraph.graph.builder import GraphConfig
    from objgraph.graph.object_graph import ObjectGraph, ObjectHandle
    from objgraph.observation.sampling import observe
    from objgraph.priors.registry import load_prior
    from objgraph.slam.incremental.object_graph import IncrementalObjectGraph

__all__ = ["GraphConfig", "IncrementalObjectGraph", "ObjectGraph", "ObjectHandle", "load_prior", "observe"]

_HOMES = {
    "GraphConfig": "objgraph.graph.builder",
    "IncrementalObjectGraph": "objgraph.slam.incremental.object_graph",
    "ObjectGraph": "objgraph.graph.object_graph",
    "ObjectHandle": "objgraph.graph.object_graph",
    "load_prior": "objgraph.priors.registry",
    "observe": "objgraph.observation.sampling",
}


def __getattr__(name: str):
    # torch and gtsam are loaded when something is first asked for, not with every submodule
    if name in _HOMES:
        return getattr(import_module(_HOMES[name]), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
