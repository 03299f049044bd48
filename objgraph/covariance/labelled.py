"""A covariance that says what each of its axes is: which quantity, in which unit and frame."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
from jaxtyping import Float
from rich.markup import escape
from rich.table import Table

from factors import checks
from factors.state import RIGID_DOF, ObjectState
from objgraph.covariance.quantile import squared_limit
from objgraph.errors import CovarianceError

POSE_AXES = (
    *(f"rotation_{axis} [rad, object frame]" for axis in "xyz"),
    *(f"translation_{axis} [m, object frame]" for axis in "xyz"),
)
"""GTSAM's Pose3 tangent in the body frame."""
RIGID_AXES = (*POSE_AXES, *(f"log_scale_{axis} [1, object axis]" for axis in "xyz"))
"""The pose's tangent, then the log-scale."""


_ROUNDING = 1e-4
"""Negative eigenvalue of the correlations that files in single precision and badly scaled products may have."""
_SINGLE = 1.1e-19
"""Standard deviation whose square is zero in single precision."""


@dataclass(frozen=True, eq=False)
class LabelledCovariance:
    """A covariance matrix with the meaning of every axis.

    Raises:
        CovarianceError: the matrix is not square, finite, symmetric and free of negative variances along any direction, or
            has another number of axes.
    """

    matrix: Float[np.ndarray, "d d"]
    axes: tuple[str, ...]
    """One label a row: quantity, unit and frame."""
    source: str
    """Whose estimate this is: "marginals" for the graph's, "adam" for the paper's, "fused" for both; "calibrated" where it
    was widened by what errors were measured to be."""
    subject: str = ""
    """Of which object."""

    def __post_init__(self) -> None:
        for name in ("source", "subject"):
            checks.instance(f"{name} of a covariance", getattr(self, name), str, CovarianceError)
        axes = checks.tuple_of("axes of a covariance", self.axes, str, CovarianceError)
        where = f"{self.subject}: the covariance" if self.subject else "the covariance"
        matrix = _matrix(where, self.matrix).copy()
        if matrix.shape != (len(axes), len(axes)):
            raise CovarianceError(f"{where} has shape {matrix.shape} and {len(axes)} axes")
        if (np.diag(matrix) < 0).any():
            raise CovarianceError(f"{where} has a negative variance")
        sigma = np.maximum(np.sqrt(np.diag(matrix)), _SINGLE)
        allowed = np.outer(sigma, sigma)  # an entry is as large at most
        if (np.abs(matrix - matrix.T) > 1e-6 * allowed).any():
            raise CovarianceError(f"{where} is not symmetric")
        if (np.abs(matrix) > allowed)[np.diag(matrix) == 0].any():
            raise CovarianceError(f"{where} has an axis that does not vary, and goes along with another")
        if _least_of_correlation(matrix) < -_ROUNDING:
            raise CovarianceError(f"{where} is indefinite: some direction would have a negative variance")
        matrix.setflags(write=False)
        object.__setattr__(self, "matrix", matrix)
        object.__setattr__(self, "axes", axes)

    @property
    def sigma(self) -> Float[np.ndarray, "d"]:
        """Standard deviation of every axis."""
        return np.sqrt(np.diag(self.matrix))

    @property
    def correlation(self) -> Float[np.ndarray, "d d"]:
        """Correlations; zero beside an axis that has no variance."""
        return _correlation(self.matrix)

    def block(self, prefix: str) -> "LabelledCovariance":
        """The axes whose labels begin with `prefix`; raises CovarianceError where none does."""
        checks.instance("the prefix of an axis", prefix, str, CovarianceError)
        rows = [i for i, axis in enumerate(self.axes) if axis.startswith(prefix)]
        if not rows:
            raise CovarianceError(f"no axis of the covariance begins with {prefix!r}")
        axes = tuple(self.axes[i] for i in rows)
        return LabelledCovariance(self.matrix[np.ix_(rows, rows)], axes, self.source, self.subject)

    def mapped(self, jacobian: Float[np.ndarray, "m d"], axes: Sequence[str]) -> "LabelledCovariance":
        """The covariance of quantities with this derivative w.r.t. the axes: J Σ J^T; raises CovarianceError where it is
        none of them."""
        jacobian = checks.reals("the derivative", jacobian, (None, len(self.axes)), error=CovarianceError)
        matrix = jacobian @ self.matrix @ jacobian.T
        return LabelledCovariance(0.5 * (matrix + matrix.T), tuple(axes), self.source, self.subject)

    def times(self, factor: float) -> Self:
        """All variances and covariances multiplied; raises CovarianceError where the factor is negative."""
        checks.number("the factor on a covariance", factor, error=CovarianceError)
        return replace(self, matrix=factor * self.matrix)

    def ellipsoid(self, probability: float = 0.95) -> tuple[Float[np.ndarray, "d d"], Float[np.ndarray, "d"]]:
        """Unit directions (columns), the longest first, and half axes of the ellipsoid that holds this share."""
        if not 0 < checks.number("the share of an ellipsoid", probability, error=CovarianceError) < 1:
            raise CovarianceError(f"an ellipsoid holds a share between 0 and 1, not {probability}")
        values, vectors = np.linalg.eigh(self.matrix)
        radius = np.sqrt(squared_limit(probability, len(values)) * np.maximum(values, 0.0))
        return vectors[:, ::-1], radius[::-1]

    def table(self) -> Table:
        """Every axis with its standard deviation, and the axis that it goes along with most."""
        table = Table(title=escape(f"{self.subject} ({self.source})".strip()))
        for label, justify in (("axis", "left"), ("std", "right"), ("goes along with", "left")):
            table.add_column(label, justify=justify, no_wrap=True)  # pyright: ignore[reportArgumentType]
        others = self.correlation
        np.fill_diagonal(others, 0.0)
        for i, (axis, sigma) in enumerate(zip(self.axes, self.sigma, strict=True)):
            j = int(np.argmax(np.abs(others[i])))
            partner = f"{others[i, j]:+.2f} {self.axes[j].split(' ')[0]}" if others[i, j] else ""
            table.add_row(escape(axis), f"{sigma:.4g}", partner)
        return table

    def to_json(self) -> dict[str, Any]:
        """Plain lists."""
        return {
            "source": self.source,
            "subject": self.subject,
            "axes": list(self.axes),
            "matrix": self.matrix.tolist(),
        }

    @classmethod
    def from_json(cls, document: Any) -> Self:
        """The inverse of `to_json`.

        Raises:
            CovarianceError: something else is in the document.
        """
        if not isinstance(document, Mapping) or set(document) != {"source", "subject", "axes", "matrix"}:
            raise CovarianceError("a covariance must have source, subject, axes and matrix")
        texts = [document["source"], document["subject"], *_listed(document["axes"])]
        if not all(isinstance(text, str) for text in texts):
            raise CovarianceError("source, subject and axes of a covariance must be text")
        try:
            matrix = np.array(document["matrix"], dtype=float)
        except (TypeError, ValueError, OverflowError) as error:
            raise CovarianceError(f"the matrix of a covariance must be numbers ({error})") from error
        return cls(matrix, tuple(document["axes"]), document["source"], document["subject"])


@dataclass(frozen=True, eq=False)
class ObjectCovariance(LabelledCovariance):
    """Joint covariance of an object's pose, log-scale and code: over `RIGID_AXES`, then the code's entries."""

    @classmethod
    def of(cls, matrix: Float[np.ndarray, "9+l 9+l"], source: str, subject: str = "") -> "ObjectCovariance":
        """A covariance over [rotation, translation, log-scale, code]."""
        matrix = _matrix("the covariance of an object", matrix)
        return cls(matrix, object_axes(len(matrix) - RIGID_DOF), source, subject)

    @classmethod
    def diagonal(
        cls, variance: Float[np.ndarray, "9+l"], source: str, subject: str = ""
    ) -> "ObjectCovariance":
        """Independent axes of these variances."""
        variance = checks.reals("the variances of an object", variance, (None,), error=CovarianceError)
        return cls.of(np.diag(variance), source, subject)

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.axes) < RIGID_DOF or self.axes != object_axes(len(self.axes) - RIGID_DOF):
            raise CovarianceError("an object's covariance is over pose, log-scale and code, in this order")

    @property
    def rigid(self) -> Float[np.ndarray, "9 9"]:
        """Rotation, translation and log-scale."""
        return self.matrix[:RIGID_DOF, :RIGID_DOF]

    @property
    def code(self) -> Float[np.ndarray, "l l"]:
        return self.matrix[RIGID_DOF:, RIGID_DOF:]


def object_axes(length: int) -> tuple[str, ...]:
    """Labels of an object's tangent with a code of this length."""
    return (*RIGID_AXES, *(f"code_{i} [1]" for i in range(length)))


def of_one_object(state: ObjectState, covariance: ObjectCovariance) -> None:
    """Raise CovarianceError where a covariance is not over the tangent of a finite state."""
    checks.instance("state", state, ObjectState, CovarianceError)
    checks.instance("covariance", covariance, ObjectCovariance, CovarianceError)
    if not np.isfinite(state.local_coordinates(state)).all() or not np.isfinite(state.scale).all():
        raise CovarianceError("the state is not finite: there is no object to have a covariance")
    if len(covariance.axes) != RIGID_DOF + len(state.code):
        raise CovarianceError(
            f"a covariance over {len(covariance.axes)} axes is not that of a state with a code of {len(state.code)}"
        )


def _correlation(matrix: Float[np.ndarray, "d d"]) -> Float[np.ndarray, "d d"]:
    sigma = np.sqrt(np.diag(matrix))
    inverse = np.divide(1.0, sigma, out=np.zeros_like(sigma), where=sigma > 0)
    return matrix * inverse * inverse[:, None]


def _least_of_correlation(matrix: Float[np.ndarray, "d d"]) -> float:
    """Smallest eigenvalue of the correlations, so that units and sizes of the axes do not matter."""
    return float(np.linalg.eigvalsh(_correlation(matrix)).min()) if len(matrix) else 0.0


def _matrix(what: str, value: Any) -> Float[np.ndarray, "n m"]:
    return checks.reals(what, value, (None, None), error=CovarianceError)


def _listed(value: Any) -> list[Any]:
    return value if isinstance(value, list) else [None]
