"""A second estimate of an object that is already in the map, by the other estimator."""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from jaxtyping import Float

from factors import checks
from objgraph.errors import MapError
from objgraph.geometry.frames import is_rigid

ESTIMATE_SHAPES: dict[str, tuple[int | None, ...]] = {
    "T_world_object": (4, 4),
    "scale": (3,),
    "code": (None,),
    "covariance": (9, 9),
    "code_sigma": (None,),
}
"""Arrays that every estimate of an object has; None is a length that the estimate chooses."""


def read_only(where: str, value: Any, shape: tuple[int | None, ...], dtype: type = np.float64) -> np.ndarray:
    """A read-only copy of finite numbers, whole ones where the type is; raises MapError naming `where`."""
    kinds = "iu" if np.issubdtype(dtype, np.integer) else "fiu"
    found = checks.array(where, value, shape, MapError, kinds=kinds).astype(dtype)
    found.flags.writeable = False
    return found


@dataclass(frozen=True, eq=False)
class OtherEstimate:
    """Pose, scale and code with their uncertainty; axes and frames are those of `MappedObject`.

    Raises:
        MapError: a field is missing, has another shape or is not finite.
    """

    estimator: str
    """Whose it is: "adam" beside the graph's."""
    T_world_object: Float[np.ndarray, "4 4"]
    scale: Float[np.ndarray, "3"]
    code: Float[np.ndarray, "l"]
    covariance: Float[np.ndarray, "9 9"]
    code_sigma: Float[np.ndarray, "l"]

    def __post_init__(self) -> None:
        if not isinstance(self.estimator, str) or not self.estimator:
            raise MapError(f"other estimate: estimator is no text ({self.estimator!r})")
        for name, shape in ESTIMATE_SHAPES.items():
            where = f"other estimate: {name}"
            if getattr(self, name) is None:
                raise MapError(f"{where} is missing")
            object.__setattr__(self, name, read_only(where, getattr(self, name), shape))
        if not is_rigid(self.T_world_object) or not (self.scale > 0).all():
            raise MapError("other estimate: the pose must be rigid and the scale positive")
        if (np.diagonal(self.covariance) < 0).any() or (self.code_sigma < 0).any():
            raise MapError("other estimate: covariance or code_sigma has a negative entry")
        if len(self.code) != len(self.code_sigma):
            raise MapError(
                f"other estimate: code_sigma has {len(self.code_sigma)} entries, the code {len(self.code)}"
            )

    def __eq__(self, other: object) -> bool:
        return isinstance(other, OtherEstimate) and self.to_json() == other.to_json()

    def to_json(self) -> dict[str, Any]:
        """Plain lists."""
        return {"estimator": self.estimator} | {
            name: getattr(self, name).tolist() for name in ESTIMATE_SHAPES
        }

    @classmethod
    def from_json(cls, document: Any) -> "OtherEstimate":
        """The inverse of `to_json`; raises MapError naming the field at fault."""
        names = [field.name for field in fields(cls)]
        if not isinstance(document, Mapping) or sorted(document) != sorted(names):
            raise MapError(f"other estimate must have {', '.join(names)}")
        return cls(**document)
