"""Estimators: the graph, the paper's gradient descent, the Gauss-Newton of DSP-SLAM."""

from objgraph.estimate.adam import AdamConfig, AdamEstimator
from objgraph.estimate.gauss_newton import GaussNewtonConfig, GaussNewtonEstimator

__all__ = ["AdamConfig", "AdamEstimator", "GaussNewtonConfig", "GaussNewtonEstimator"]
