"""Colours: of methods and objects beside each other, and the one scale for standard deviations of surfaces."""

from collections.abc import Iterable
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, UInt8

if TYPE_CHECKING:
    from matplotlib.colors import Colormap

COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000", "#8C564B")
"""Okabe and Ito's, which the colour-blind can tell apart."""
_COLORMAP = "viridis"
"""Perceptually uniform, and readable by the colour-blind."""
_DARKEST = 0.22
"""Where the scale begins on the colour map: what is below would be black in a shaded picture."""


def sigma_colormap() -> "Colormap":
    """The scale's colours, least uncertain first."""
    import matplotlib  # slow to import, and a map needs it only where it is drawn
    from matplotlib.colors import ListedColormap

    return ListedColormap(matplotlib.colormaps[_COLORMAP](np.linspace(_DARKEST, 1, 256)))


def sigma_limit(sigmas: Iterable[Float[np.ndarray, "v"] | None]) -> float | None:
    """The top of the scale in metres: the 98th percentile over all objects; None without any sigma."""
    present = [sigma for sigma in sigmas if sigma is not None and len(sigma)]
    return max(float(np.percentile(np.concatenate(present), 98)), 1e-6) if present else None


def sigma_colors(sigma: Float[np.ndarray, "v"], limit: float) -> UInt8[np.ndarray, "v 3"]:
    """RGB of standard deviations in metres on the scale from 0 to `limit`; what lies above takes the top."""
    shares = np.clip(np.asarray(sigma, float) / limit, 0, 1)
    return np.round(255 * sigma_colormap()(shares)[:, :3]).astype(np.uint8)
