"""Object-level mapping with learnt shape priors, as a factor graph.

What is needed every day is here; rooms (`objgraph.active`, `covariance`, `datasets`, `maps`, `observation`, `show`, `slam`,
`trust`) have the rest of their kind. Nothing is loaded before it is asked for.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from factors.state import ObjectKeys, ObjectState
    from objgraph import active, covariance, datasets, maps, observation, show, slam, trust
    from objgraph.active.next_view import next_views
    from objgraph.covariance.labelled import ObjectCovariance
    from objgraph.datasets.registry import load_lidar_frame, load_scan
    from objgraph.errors import ObjectGraphError
    from objgraph.graph.builder import DetectedBox, GraphConfig, ObjectBuilder
    from objgraph.graph.handle import ObjectHandle
    from objgraph.graph.headings import place
    from objgraph.graph.object_graph import ObjectGraph
    from objgraph.graph.solve import Problem, SolverConfig, solve
    from objgraph.maps.object_map import ObjectMap
    from objgraph.maps.pipeline import MappingConfig, map_scan
    from objgraph.observation.frames import Frame, Instance, Intrinsics, Scan
    from objgraph.observation.sampling import ObjectView, SamplingConfig, observe
    from objgraph.priors.registry import load_prior, prior_for
    from objgraph.priors.shape_prior import ShapePrior
    from objgraph.slam.incremental.config import IncrementalConfig
    from objgraph.slam.incremental.object_graph import IncrementalObjectGraph
    from objgraph.slam.incremental.own_smoother import ObjectFrontEnd

__all__ = [
    "DetectedBox",
    "Frame",
    "GraphConfig",
    "IncrementalConfig",
    "IncrementalObjectGraph",
    "Instance",
    "Intrinsics",
    "MappingConfig",
    "ObjectBuilder",
    "ObjectCovariance",
    "ObjectFrontEnd",
    "ObjectGraph",
    "ObjectGraphError",
    "ObjectHandle",
    "ObjectKeys",
    "ObjectMap",
    "ObjectState",
    "ObjectView",
    "Problem",
    "SamplingConfig",
    "Scan",
    "ShapePrior",
    "SolverConfig",
    "active",
    "covariance",
    "datasets",
    "load_lidar_frame",
    "load_prior",
    "load_scan",
    "map_scan",
    "maps",
    "next_views",
    "observation",
    "observe",
    "place",
    "prior_for",
    "show",
    "slam",
    "solve",
    "trust",
]

_HOMES = {
    "factors.state": "ObjectKeys ObjectState",
    "objgraph.active.next_view": "next_views",
    "objgraph.covariance.labelled": "ObjectCovariance",
    "objgraph.datasets.registry": "load_lidar_frame load_scan",
    "objgraph.errors": "ObjectGraphError",
    "objgraph.graph.builder": "DetectedBox GraphConfig ObjectBuilder",
    "objgraph.graph.headings": "place",
    "objgraph.graph.handle": "ObjectHandle",
    "objgraph.graph.object_graph": "ObjectGraph",
    "objgraph.graph.solve": "Problem SolverConfig solve",
    "objgraph.maps.object_map": "ObjectMap",
    "objgraph.maps.pipeline": "MappingConfig map_scan",
    "objgraph.observation.frames": "Frame Instance Intrinsics Scan",
    "objgraph.observation.sampling": "ObjectView SamplingConfig observe",
    "objgraph.priors.registry": "load_prior prior_for",
    "objgraph.priors.shape_prior": "ShapePrior",
    "objgraph.slam.incremental.config": "IncrementalConfig",
    "objgraph.slam.incremental.object_graph": "IncrementalObjectGraph",
    "objgraph.slam.incremental.own_smoother": "ObjectFrontEnd",
}
_HOME_OF = {name: home for home, names in _HOMES.items() for name in names.split()}
_ROOMS = ("active", "covariance", "datasets", "maps", "observation", "show", "slam", "trust")


def __getattr__(name: str):
    if name in _HOME_OF:
        return getattr(import_module(_HOME_OF[name]), name)
    if name in _ROOMS:
        return import_module(f"objgraph.{name}")
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return [*__all__]
