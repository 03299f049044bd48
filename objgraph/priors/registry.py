"""Shape priors by category or by file."""

import logging
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path

from objgraph.errors import PriorError
from objgraph.priors.categories import category_of, plain
from objgraph.priors.fallback import NAME, fallback_prior
from objgraph.priors.shape_prior import ShapePrior
from objgraph.priors.store import load_prior_file

log = logging.getLogger(__name__)

WEIGHTS = Path(__file__).parent / "weights"


def available_priors() -> tuple[str, ...]:
    """Categories whose priors ship with the library."""
    return tuple(sorted(path.stem for path in WEIGHTS.glob("*.safetensors")))


def load_prior(category_or_path: str | Path) -> ShapePrior:
    """The prior of a category (or one of its aliases), or of a `.safetensors` file; read anew, the caller's own.

    Raises:
        PriorError: an unknown category (the message names those there are), or a file that is no prior.
    """
    path = Path(category_or_path)
    if path.suffix == ".safetensors":
        return load_prior_file(path)
    shipped = _shipped_file(str(category_or_path))
    if shipped is None:
        known = ", ".join(available_priors()) or "none is installed"
        raise PriorError(
            f"there is no shape prior for category {str(category_or_path)!r}; available: {known} "
            f"(or give the path of a .safetensors file that `objgraph train` wrote)"
        )
    return load_prior_file(shipped)


def prior_for(category: str, given: Sequence[ShapePrior] = ()) -> ShapePrior:
    """The prior to map objects of a category with: one of those given, the shipped one, or the labelled fallback.

    Unlike `load_prior`, which answers a request by name, this survives every category; a category's first warning says
    what the fallback lacks and how to do better, or that a given prior is of another label that means it, and not used.
    All who ask in a process share one prior, so that their objects are decoded together: leave it as it is.

    Raises:
        PriorError: the category's own file is damaged.
    """
    for wanted in (category, category_of(category)):  # an armchair's own before a chair's
        for prior in given:
            if plain(prior.category) == plain(wanted):
                return prior
    for prior in given:
        if category_of(prior.category) == category_of(category):
            _warn_of_other_name(plain(prior.category), plain(category))
    shipped = _shipped_file(category)
    if shipped is not None:
        return _shared(shipped)
    _warn_of_fallback(plain(category))
    return _stand_in(category)


def _shipped_file(category: str) -> Path | None:
    name = category_of(category)
    return WEIGHTS / f"{name}.safetensors" if name in available_priors() else None


@cache
def _shared(shipped: Path) -> ShapePrior:
    return load_prior_file(shipped)


@cache
def _stand_in(category: str) -> ShapePrior:
    return replace(_superquadric(), category=category)


@cache
def _superquadric() -> ShapePrior:
    return fallback_prior(NAME)


@cache
def _warn_of_other_name(given: str, wanted: str) -> None:
    log.warning(
        "the prior given for '%s' serves no object that is called '%s': make it with --category '%s' if it should",
        given,
        wanted,
        category_of(wanted),
    )


@cache
def _warn_of_fallback(name: str) -> None:
    log.warning(
        "no shape prior for category '%s': a %s stands in (priors: %s; `objgraph train` makes one from a folder of "
        "meshes, `objgraph convert-prior` from a DeepSDF checkpoint)",
        name,
        NAME,
        ", ".join(available_priors()) or "none is installed",
    )
