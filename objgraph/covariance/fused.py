"""Two estimates of the same object as one."""

import numpy as np

from factors import checks
from factors.state import ObjectState
from objgraph.covariance.labelled import ObjectCovariance, of_one_object
from objgraph.errors import CovarianceError


def fused(
    first: tuple[ObjectState, ObjectCovariance],
    second: tuple[ObjectState, ObjectCovariance],
    share: float = 0.5,
) -> tuple[ObjectState, ObjectCovariance]:
    """Covariance intersection (Julier & Uhlmann, 1997) of two estimates from the same data.

    Their errors go together by nobody knows how much: information is shared out, not added, so the result is
    consistent where both are. `share` is the first one's. Errors are taken in the tangent at the first state.

    Raises:
        CovarianceError: `share` is not between 0 and 1, the codes are of different decoders, or a covariance is not
            positive definite.
    """
    if not 0 < checks.number("the first estimate's share", share, error=CovarianceError) < 1:
        raise CovarianceError(f"the first estimate's share must be between 0 and 1, not {share}")
    for each in (first, second):
        if not isinstance(each, tuple) or len(each) != 2:
            raise CovarianceError(
                f"an estimate must be a state and its covariance, not a {type(each).__name__}"
            )
        checks.instance("the state of an estimate", each[0], ObjectState, CovarianceError)
        checks.instance("the covariance of an estimate", each[1], ObjectCovariance, CovarianceError)
    (state, a), (other, b) = first, second
    if len(a.matrix) != len(b.matrix) or len(state.code) != len(other.code):
        raise CovarianceError("estimates of different decoders cannot be fused")
    for each in (first, second):
        of_one_object(*each)
    for name, each in (("first", a), ("second", b)):
        checks.covariance(f"the {name} estimate's covariance", each.matrix, None, CovarianceError)
    information_a, information_b = (_inverse(each.matrix) for each in (a, b))
    matrix = _inverse(share * information_a + (1 - share) * information_b)
    difference = np.concatenate(
        [
            state.T_world_object.localCoordinates(other.T_world_object),
            other.log_scale - state.log_scale,
            other.code - state.code,
        ]
    )
    moved = state.retract(matrix @ ((1 - share) * information_b @ difference))
    return moved, ObjectCovariance.of(matrix, "fused", a.subject)


def _inverse(matrix: np.ndarray) -> np.ndarray:
    inverse = np.linalg.inv(matrix)
    return 0.5 * (inverse + inverse.T)
