"""Shape priors by category or by file."""

from pathlib import Path

from objgraph.errors import PriorError
from objgraph.prior.prior import ShapePrior
from objgraph.prior.store import load_prior_file

WEIGHTS = Path(__file__).parent / "weights"

ALIASES = {
    "armchair": "chair",
    "office chair": "chair",
    "office_chair": "chair",
    "stool": "chair",
    "03001627": "chair",
    "desk": "table",
    "coffee table": "table",
    "coffee_table": "table",
    "dining table": "table",
    "dining_table": "table",
    "04379243": "table",
}
"""Labels of common data sets (and ShapeNet's synset ids) that a shipped prior serves."""


def available_priors() -> tuple[str, ...]:
    """Categories whose priors ship with the library."""
    return tuple(sorted(path.stem for path in WEIGHTS.glob("*.safetensors")))


def load_prior(category_or_path: str | Path) -> ShapePrior:
    """The prior of a category (or one of its aliases), or of a `.safetensors` file.

    Raises:
        PriorError: an unknown category (the message names those there are), or a file that is no prior.
    """
    path = Path(category_or_path)
    if path.suffix == ".safetensors":
        return load_prior_file(path)
    name = str(category_or_path).strip().lower()
    shipped = WEIGHTS / f"{ALIASES.get(name, name)}.safetensors"
    if shipped.stem not in available_priors():
        known = ", ".join(available_priors()) or "none is installed"
        raise PriorError(
            f"there is no shape prior for category {str(category_or_path)!r}; available: {known} "
            f"(or give the path of a .safetensors file that `objgraph train` wrote)"
        )
    return load_prior_file(shipped)
