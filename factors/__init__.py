"""GTSAM factors over an object's pose, scale and learnt shape code."""
