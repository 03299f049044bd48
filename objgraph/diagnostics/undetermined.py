"""What a graph leaves undetermined: which variables, in which directions, and which prior is missing."""

from collections.abc import Iterable, Sequence

import gtsam
import numpy as np

from factors.keys import readable_key
from factors.state import ObjectKeys
from objgraph.diagnostics.directions import in_words
from objgraph.diagnostics.keys import roles
from objgraph.diagnostics.linear import tangent_dims
from objgraph.diagnostics.naming import MISSING, Naming, Undetermined
from objgraph.diagnostics.null_space import TOLERANCE, null_space, scaled_jacobian
from objgraph.errors import SolveError


def undetermined(
    graph: gtsam.NonlinearFactorGraph,
    values: gtsam.Values,
    objects: Iterable[ObjectKeys] = (),
    tolerance: float = TOLERANCE,
) -> list[Undetermined]:
    """Everything that `graph`, linearised at `values`, does not determine.

    A direction counts as undetermined where the factors together say less of it than `tolerance` times what they
    say of the variables in it (singular values of the Jacobian whose blocks have been scaled to unit columns).
    `objects` are the keys of objects that have none of the default letters.

    Raises:
        SolveError: a factor's variable is not in the values, or one or a factor is not finite; the message names it.
    """
    found = loose_directions(linearised(graph, values), values, objects, tolerance)
    known = set(graph.keyVector())
    return found + without_factors([key for key in values.keys() if key not in known], values, objects)  # noqa: SIM118


def without_factors(
    keys: Iterable[int], values: gtsam.Values, objects: Iterable[ObjectKeys] = ()
) -> list[Undetermined]:
    """What is undetermined of variables that are in the values and in no factor: all of them."""
    zero = values.zeroVectors()
    dims = {key: zero.at(key).size for key in keys}
    found = []
    for key, role in roles(dims, values, objects).items():
        words = "; ".join(in_words(role, np.eye(dims[key])))
        found.append(Undetermined((key,), f"no factor is on it: {words}", MISSING[role], dims[key]))
    return found


def loose_directions(
    linear: gtsam.GaussianFactorGraph,
    values: gtsam.Values,
    objects: Iterable[ObjectKeys] = (),
    tolerance: float = TOLERANCE,
    at_least: int = 0,
) -> list[Undetermined]:
    """As `undetermined`, of a graph that is linearised already.

    With `at_least`, that many of the loosest directions are named even if they are above `tolerance`. Raises SolveError
    of a factor that is not finite: what is no number would count as none.
    """
    check_finite(linear)
    dims = tangent_dims(linear)
    if not dims:
        return []
    role = roles(dims, values, objects)
    jacobian = scaled_jacobian(linear, dims, role)
    loose = null_space(jacobian.matrix, tolerance, at_least)
    return Naming(jacobian, role, values, tolerance).all_of(loose) if loose.shape[1] else []


def check_determined(
    graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, objects: Iterable[ObjectKeys] = ()
) -> None:
    """Refuse a graph that leaves something undetermined; what an optimiser's damping would hide.

    Costs one linearisation of `graph` and a fraction of one.

    Raises:
        SolveError: something is not determined, or not finite; the message names keys, directions and the missing priors.
    """
    check_linear(linearised(graph, values), values, objects)


def check_linear(
    linear: gtsam.GaussianFactorGraph, values: gtsam.Values, objects: Iterable[ObjectKeys] = ()
) -> None:
    """As `check_determined`, of a graph that is linearised already."""
    found = loose_directions(linear, values, objects)
    if found:
        raise SolveError(explanation(found))


def linearised(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> gtsam.GaussianFactorGraph:
    """`graph` at `values`; raises SolveError where a factor's variable is not in them or has a value that is not finite."""
    require_values(graph, values)
    own = values.extract(graph.keyVector())
    # which of any type of variable differs from itself
    if keys := _not_finite(own.localCoordinates(own), own.keys()):
        raise SolveError(f"the value of {_names(keys)} is not finite: insert another estimate")
    return graph.linearize(values)


def check_finite(linear: gtsam.GaussianFactorGraph) -> None:
    """Raise SolveError where a factor has a Jacobian or an error that is not finite."""
    if not _not_finite(linear.gradientAtZero(), linear.keyVector()):
        return
    for i in range(linear.size()):
        if linear.exists(i) and not np.isfinite(linear.at(i).augmentedJacobian()).all():
            raise SolveError(
                f"the factor on {_names(linear.at(i).keys())} is not finite: look at what it measured, at its noise and at "
                "the values"
            )


def _not_finite(vectors: gtsam.VectorValues, keys: Iterable[int]) -> list[int]:
    if np.isfinite(vectors.norm()):  # nearly always
        return []
    return [key for key in keys if not np.isfinite(vectors.at(key)).all()]


def _names(keys: Iterable[int]) -> str:
    return ", ".join(map(readable_key, keys))


def require_values(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> None:
    """Raise SolveError where a factor's variable is not in the values."""
    for key in graph.keyVector():
        if not values.exists(key):
            raise SolveError(
                f"the graph has factors on {readable_key(key)}, which is not in the values: "
                "insert a first estimate of it"
            )


def explanation(found: Sequence[Undetermined], most: int = 4) -> str:
    """One sentence for an error message."""
    shown = "; ".join(str(item) for item in found[:most])
    more = f"; and {len(found) - most} more" if len(found) > most else ""
    return f"the graph does not determine {shown}{more}"
