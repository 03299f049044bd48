"""Errors of an estimate against ground truth, as the paper measures them."""
