"""Objects that look alike from all sides have no heading; a Gaussian about one of them does not know."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from factors import checks
from factors.state import ObjectState
from objgraph.covariance.labelled import ObjectCovariance
from objgraph.errors import CovarianceError

HEADINGS = 24
"""Turned by so many equal steps, an object is back where it was."""
_HEADING = 1
"""Rotation about the object's y axis, which is up in every prior's frame, in `RIGID_AXES`."""
_DOUBTFUL = np.radians(2.5)
"""A heading that is known better than this locally, all else being known, is not asked for elsewhere."""
_NEGLIGIBLE = 1e-4
"""Probability of a heading that is left out."""


def with_other_headings(
    covariance: ObjectCovariance, costs: Callable[[], Float[np.ndarray, "24"]]
) -> ObjectCovariance:
    """The covariance with the headings in it that are about as likely as the estimate's own.

    `costs` gives what the object costs turned by 0, 1, ... of the `HEADINGS` steps about its up axis, all else held; it is asked only where the heading is doubtful. What the variance of the heading so found
    exceeds the Gaussian's own by, everything else being held, is added: nothing where the posterior is Gaussian,
    pi^2 / 3 in all where every heading is as likely. Raises CovarianceError where the covariance is not positive definite.
    """
    checks.instance("the covariance of an object", covariance, ObjectCovariance, CovarianceError)
    matrix = checks.covariance("the covariance of an object", covariance.matrix, None, CovarianceError)
    known = 1.0 / np.linalg.inv(matrix)[_HEADING, _HEADING]
    if known < _DOUBTFUL**2:
        return covariance
    matrix = covariance.matrix.copy()
    matrix[_HEADING, _HEADING] += max(heading_variance(costs()) - known, 0.0)
    return replace(covariance, matrix=matrix)


def by_heading(
    state: ObjectState, covariance: ObjectCovariance
) -> list[tuple[float, ObjectState, ObjectCovariance]]:
    """The same distribution in parts, each with its probability, whose heading is known to a step: one where it is anyway, up to
    `HEADINGS` where nothing tells it. A full turn leads back; what goes along with the heading is turned with it."""
    matrix, step = covariance.matrix, 2 * np.pi / HEADINGS
    variance, within = matrix[_HEADING, _HEADING], step**2 / 12
    if variance < step**2:
        return [(1.0, state, covariance)]
    along = matrix[:, _HEADING] / variance
    known = replace(covariance, matrix=matrix - (variance - within) * np.outer(along, along))
    angle = step * (np.arange(HEADINGS) - HEADINGS // 2)
    wound = angle[:, None] + 2 * np.pi * np.arange(-5, 6)
    # what is known to a full turn is not known at all
    weight = np.exp(-0.5 * wound**2 / min(variance - within, 4 * np.pi**2)).sum(axis=1)
    weight /= weight.sum()
    return [
        (float(share), state.retract(along * turn), known)
        for share, turn in zip(weight, angle, strict=True)
        if share > _NEGLIGIBLE
    ]


def heading_variance(costs: Float[np.ndarray, "n"]) -> float:
    """Mean square of the angle from the first heading, of n evenly spaced ones with these costs.

    They are taken as negative log-posteriors, at temperature one; they are weighted scores, and none was fitted here.
    """
    costs = np.where(np.isfinite(costs), costs, np.inf)  # where the decoder fails, the object is not
    angle = 2 * np.pi * np.arange(len(costs)) / len(costs)
    angle = np.minimum(angle, 2 * np.pi - angle)
    weight = np.exp(costs.min() - costs)
    return float(weight @ angle**2 / weight.sum())
