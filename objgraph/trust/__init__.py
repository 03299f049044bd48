"""How far an estimate is to be trusted: evidence, a verdict, and covariances that were calibrated against true objects."""

from objgraph.trust.calibration import Calibration, load_calibration, shipped_calibration
from objgraph.trust.evidence import Evidence, evidence_of
from objgraph.trust.verdict import Trust

__all__ = [
    "Calibration",
    "Evidence",
    "Trust",
    "evidence_of",
    "load_calibration",
    "shipped_calibration",
]
