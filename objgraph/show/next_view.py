"""What every direction of view is expected to tell, as a picture."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from objgraph.active.next_view import Criterion, ViewGain
from objgraph.active.target import Target
from objgraph.geometry.frames import level_axes
from objgraph.maps.colors import sigma_colors, sigma_limit
from objgraph.show.figure import finish

LABELS: dict[Criterion, str] = {
    "corners": "expected decrease of the corners' mean square error (cm²)",
    "information": "expected information on pose, scale and shape (nats)",
    "pose": "expected information on the 9-DoF pose (nats)",
    "surface": "expected decrease of the mean surface variance (cm²)",
}
UNITS: dict[Criterion, float] = {"corners": 1e4, "information": 1.0, "pose": 1.0, "surface": 1e4}
"""From `ViewGain.total` to the label's unit."""


def sphere_picture(
    target: Target,
    sigma: Float[np.ndarray, "m"],
    views: Sequence[ViewGain],
    up_world: Float[np.ndarray, "3"],
    path: Path,
    *,
    criterion: Criterion = "corners",
) -> None:
    """The object's points by their standard deviation and the candidates about it by what they are expected to tell.

    `sigma` (metres) is of `target.points`; `views` are ranked, the first is marked; so are those the estimate is made from.
    """
    up = np.asarray(up_world, float)
    axes = np.stack([*level_axes(up), up])
    figure = Figure(figsize=(11, 5.2), dpi=100)
    eyes = np.array([view.T_world_camera.translation() for view in views])
    gains = UNITS[criterion] * np.array([view.total(criterion) for view in views])
    scale = Normalize(gains.min(), gains.max())
    limit = sigma_limit([sigma]) or 1.0
    for column, (elevation, azimuth, title) in enumerate(
        ((20, -60, "from the side"), (89, -90, "from above"))
    ):
        axis = figure.add_subplot(1, 2, column + 1, projection="3d", computed_zorder=False)
        points = (target.points - target.centre) @ axes.T
        axis.scatter(*points.T, c=sigma_colors(sigma, limit) / 255.0, s=5, depthshade=False)
        dots = (eyes - target.centre) @ axes.T
        shown = axis.scatter(
            *dots.T, c=gains, norm=scale, cmap="viridis", s=36, depthshade=False, edgecolors="0.4"
        )
        axis.scatter(
            *dots[:1].T, s=260, facecolors="none", edgecolors="red", linewidths=2.0, depthshade=False
        )
        if target.seen_from:
            seen = (np.array([camera.translation() for camera in target.seen_from]) - target.centre) @ axes.T
            axis.scatter(*seen.T, marker="x", c="black", s=70, depthshade=False)
        limits = np.array([axis.get_xlim(), axis.get_ylim(), axis.get_zlim()])
        axis.set_box_aspect(np.ptp(limits, axis=1), zoom=1.25)  # pyright: ignore[reportArgumentType]
        axis.view_init(elevation, azimuth)
        axis.set_axis_off()
        axis.text2D(0.5, 0.06, title, fontsize=10, color="0.35", ha="center", transform=axis.transAxes)
    figure.subplots_adjust(left=0.0, right=0.9, bottom=-0.06, top=0.98, wspace=0.0)
    bar = figure.colorbar(shown, cax=figure.add_axes((0.92, 0.15, 0.015, 0.6)))
    bar.set_label(LABELS[criterion], fontsize=9)
    figure.text(0.02, 0.94, f"{target.name}: where to look next", fontsize=14, weight="bold", va="center")
    figure.text(
        0.02, 0.885, f"ring: the next best view; crosses: views so far; the object's points: blue certain, "
        f"yellow {100 * limit:.1f} cm or more", fontsize=9, color="0.35", va="center",
    )  # fmt: skip
    finish(figure, None, None, path)
