"""Two estimates of the same object as one."""

import numpy as np

from factors.state import ObjectState
from objgraph.covariance.labelled import ObjectCovariance
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
        CovarianceError: `share` is not between 0 and 1, or the codes are of different decoders.
    """
    if not 0 < share < 1:
        raise CovarianceError(f"the first estimate's share must be between 0 and 1, not {share}")
    (state, a), (other, b) = first, second
    if len(a.matrix) != len(b.matrix) or len(state.code) != len(other.code):
        raise CovarianceError("estimates of different decoders cannot be fused")
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
