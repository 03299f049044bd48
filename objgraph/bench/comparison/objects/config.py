"""Settings of a comparison, and all that its rows depend on."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields, is_dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

from objgraph.bench.comparison.contenders.methods import method
from objgraph.bench.comparison.objects.cases import CaseSource
from objgraph.bench.comparison.objects.rows import SHARED, method_and_start
from objgraph.bench.comparison.objects.uncertainty import POINTS
from objgraph.graph.builder import GraphConfig
from objgraph.graph.initialise import InitialisationConfig
from objgraph.observation.sampling import SamplingConfig
from objgraph.priors.mesh import RESOLUTION
from objgraph.priors.registry import prior_for
from objgraph.priors.shape_prior import ShapePrior
from objgraph.priors.store import load_prior_file


@dataclass(frozen=True)
class ComparisonConfig:
    """What all methods have in common."""

    seed: int = 0
    """Of everything that is sampled from frames and surfaces."""
    threads: int = 1
    """Of an estimate."""
    mesh_resolution: int = RESOLUTION
    """Cells along an edge of the canonical cube."""
    surface_points: int = POINTS
    """Points of the true surface at which error and standard deviation are compared."""
    kept_points: int = 200
    """How many of them are kept in an object's row."""
    sampling: SamplingConfig = field(default_factory=SamplingConfig)
    """Of the views that the start is found from."""
    initialisation: InitialisationConfig = field(default_factory=InitialisationConfig)
    """How the one start of all methods is found."""
    graph: GraphConfig = field(default_factory=GraphConfig)
    """The problem that tells guesses apart while it is found."""
    priors: tuple[str, ...] = ()
    """Your own priors, .safetensors files: each serves its category in place of the shipped one."""


@lru_cache(maxsize=16)
def find_prior(category: str, files: tuple[str, ...]) -> ShapePrior:
    """The prior of a category: of one of the files, the shipped one, or the labelled fallback."""
    return prior_for(category, [load_prior_file(Path(file)) for file in files])


def prior_hash(category: str, config: ComparisonConfig) -> str:
    """The digest of the weights that objects of a category are estimated with."""
    return find_prior(category, config.priors).digest


def row_settings(source: CaseSource, config: ComparisonConfig, name: str, category: str) -> dict[str, Any]:
    """All that a row of a method and a category depends on, as JSON values.

    Raises:
        EvaluationError: there is no such method.
    """
    name, start = method_and_start(name)
    chosen, prior = method(name), find_prior(category, config.priors)
    common = {k: v for k, v in asdict(config).items() if k != "priors"}
    return {
        "data": {"dataset": source.dataset, **source.settings()},
        "common": settings_of(common),
        "method": {"estimator": settings_of(chosen.estimator()), "sampling": settings_of(chosen.sampling)},
        "start": "best" if start == SHARED else chosen.start,
        "prior": prior_hash(category, config),
        "surface_misfit": prior.surface_misfit,
    }


def settings_of(value: Any) -> Any:
    """Settings as JSON values; of an object that holds nothing its class. Fields that do not count in comparisons are none."""
    if is_dataclass(value) and not isinstance(value, type):
        items = {item.name: settings_of(getattr(value, item.name)) for item in fields(value) if item.compare}
        return {"class": type(value).__qualname__, **items}
    if isinstance(value, Mapping):
        return {str(key): settings_of(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [settings_of(item) for item in value]
    if value is None or isinstance(value, bool | int | float | str):
        return value
    if hasattr(value, "tolist"):
        return value.tolist()
    held = settings_of(vars(value)) if hasattr(value, "__dict__") and not isinstance(value, type) else {}
    return {"class": getattr(value, "__qualname__", type(value).__qualname__), **held}
