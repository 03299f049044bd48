"""Object-level mapping with learnt shape priors, as a factor graph."""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from objgraph.graph import ObjectGraph, ObjectHandle
    from objgraph.incremental.object_graph import IncrementalObjectGraph
    from objgraph.object_factors import GraphConfig
    from objgraph.prior.registry import load_prior
    from objgraph.sampling import observe

__all__ = ["GraphConfig", "IncrementalObjectGraph", "ObjectGraph", "ObjectHandle", "load_prior", "observe"]

_HOMES = {
    "GraphConfig": "objgraph.object_factors",
    "IncrementalObjectGraph": "objgraph.incremental.object_graph",
    "ObjectGraph": "objgraph.graph",
    "ObjectHandle": "objgraph.graph",
    "load_prior": "objgraph.prior.registry",
    "observe": "objgraph.sampling",
}


def __getattr__(name: str):
    # torch and gtsam are loaded when something is first asked for, not with every submodule
    if name in _HOMES:
        return getattr(import_module(_HOMES[name]), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
