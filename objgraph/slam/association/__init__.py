"""Which mapped objects the detections of a frame are, and which mapped objects are one and the same."""

from objgraph.slam.association.associate import associate
from objgraph.slam.association.duplicates import duplicates
from objgraph.slam.association.types import (
    Association,
    AssociationConfig,
    Detection,
    MappedCandidate,
    Match,
    Merge,
    Unmatched,
)

__all__ = [
    "Association",
    "AssociationConfig",
    "Detection",
    "MappedCandidate",
    "Match",
    "Merge",
    "Unmatched",
    "associate",
    "duplicates",
]
