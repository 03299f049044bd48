"""How long an honest error may be."""

from scipy.special import gammaincinv


def squared_limit(probability: float, dimension: int) -> float:
    """The squared Mahalanobis length that this share of Gaussian errors stays below: the chi-squared quantile.

    scipy.stats has it too, but takes over a second to import.
    """
    return float(2 * gammaincinv(dimension / 2, probability))
