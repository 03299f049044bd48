"""How far an estimate is to be trusted: evidence, a verdict, and covariances that were calibrated against true objects."""

from objgraph.trust.calibration import Calibration, load_calibration, shipped_calibration
from objgraph.trust.evidence import Evidence, evidence_of
from objgraph.trust.judge import Judgement, judge, judge_estimate
from objgraph.trust.verdict import Trust

__all__ = [
    "Calibration",
    "Evidence",
    "Judgement",
    "Trust",
    "evidence_of",
    "judge",
    "judge_estimate",
    "load_calibration",
    "shipped_calibration",
]
