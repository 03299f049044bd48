"""The paper's estimator, and the Gauss-Newton of DSP-SLAM: both work on the same sampled terms."""

from objgraph.estimate.adam import AdamConfig, AdamEstimator
from objgraph.estimate.gauss_newton import GaussNewtonConfig, GaussNewtonEstimator

__all__ = ["AdamConfig", "AdamEstimator", "GaussNewtonConfig", "GaussNewtonEstimator"]
