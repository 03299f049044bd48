"""Pictures of a comparison: error against the number of views, and error against the uncertainty given with it."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullLocator
from scipy.stats import binomtest

from objgraph.bench.comparison.objects.calibration import holding_levels
from objgraph.bench.comparison.objects.rows import STARTS, ObjectRow, method_and_start
from objgraph.bench.comparison.writing.report import Entry
from objgraph.maps.colors import COLORS
from objgraph.show.figure import finish

_MARKERS = "os^Dv<>P"
_ERRORS = (
    ("median_chamfer_m", 100.0, "Chamfer distance (cm)"),
    ("median_translation_m", 100.0, "translation error (cm)"),
    ("median_rotation_deg", 1.0, "rotation error (deg)"),
)
_FAULTS = (
    ("visible", 100.0, "surface seen by all views (%)"),
    ("camera_error_m", 100.0, "error of camera positions (cm)"),
    ("mask_iou", 100.0, "IoU of masks with what is seen (%)"),
)
_PARTS = 4
_BINS = 10
_FEWEST = 20
"""Points in a bin below which it is not drawn."""


def error_plot(entries: Sequence[Entry], methods: Sequence[str], data: str, path: Path) -> None:
    """Median errors with their intervals against the number of views: a row an error, a column a category."""
    categories = list(dict.fromkeys(e["category"] for e in entries))
    views = sorted({e["views"] for e in entries})
    figure = Figure(figsize=(1.2 + 4.2 * len(categories), 8.4), dpi=110, layout="constrained")
    axes = figure.subplots(len(_ERRORS), len(categories), squeeze=False, sharex=True)
    for column, category in enumerate(categories):
        for row, (name, factor, label) in enumerate(_ERRORS):
            axis = axes[row, column]
            for i, method in enumerate(methods):
                chosen = {
                    e["views"]: e for e in entries if (e["contender"], e["category"]) == (method, category)
                }
                shift = 0.06 * (i - (len(methods) - 1) / 2)
                _line(axis, [chosen.get(v) for v in views], np.array(views) + shift, name, factor, i, method)
            axis.set_yscale("log")  # a method that diverges is hundreds of times as far off as others
            _tick(axis.yaxis)
            axis.grid(alpha=0.3)
            if column == 0:
                axis.set_ylabel(label)
        axes[0, column].set_title(f"{category}, n = {_most(entries, category)}")
        axes[-1, column].set_xlabel("views")
        axes[-1, column].set_xticks(views)
        axes[-1, column].set_xlim(min(views) - 0.4, max(views) + 0.4)
    _legend(figure, axes[0, 0], len(categories))
    figure.suptitle(f"Median error, 95 % bootstrap over shapes ({data})", fontsize=11)
    finish(figure, None, None, path)


def _tick(side: Axis) -> None:
    """Ticks of a logarithmic axis, as plain numbers."""
    side.set_major_locator(LogLocator(10, subs=(1, 2, 5)))
    side.set_major_formatter("{x:g}")
    side.set_minor_locator(NullLocator())


def uncertainty_plot(rows: Sequence[ObjectRow], methods: Sequence[str], data: str, path: Path) -> bool:
    """Mean |SDF error| in bins of its standard deviation, over well-reconstructed objects: a panel a category.

    An honest Gaussian standard deviation lies on the line sqrt(2/pi) sigma. False, and no picture, where no method
    gives standard deviations.
    """
    rows = [row for row in rows if row.well_reconstructed and row.surface_sigma]
    categories = list(dict.fromkeys(row.category for row in rows))
    if not categories:
        return False
    figure = Figure(figsize=(1.2 + 4.6 * len(categories), 4.9), dpi=110, layout="constrained")
    axes = figure.subplots(1, len(categories), squeeze=False, sharex=True, sharey=True)[0]
    for axis, category in zip(axes, categories, strict=True):
        for i, method in enumerate(methods):
            chosen = [row for row in rows if (row.contender, row.category) == (method, category)]
            if chosen:
                sigma, error = binned(*_points(chosen))
                label = f"{method}, n = {len(chosen)}"
                axis.plot(100 * sigma, 100 * error, **_style(i), label=label)
        axis.set_xscale("log")
        axis.set_yscale("log")
        for side in (axis.xaxis, axis.yaxis):
            _tick(side)
        axis.grid(alpha=0.3, which="both")
        axis.set_title(category)
        axis.set_xlabel("standard deviation of the SDF (cm)")
    axes[0].set_ylabel("mean |SDF error| (cm)")
    for axis in axes:
        span = np.array(axis.get_xlim())
        axis.plot(
            span, np.sqrt(2 / np.pi) * span, "--", color="0.5", label="Gaussian errors of this size", zorder=0
        )
        axis.set_xlim(span)
        axis.legend(fontsize=8, loc="upper left")
    figure.suptitle(f"Error against uncertainty on the true surface ({data})", fontsize=11)
    finish(figure, None, None, path)
    return True


def binned(
    sigma: Float[np.ndarray, "n"], error: Float[np.ndarray, "n"], bins: int = _BINS
) -> tuple[Float[np.ndarray, "b"], Float[np.ndarray, "b"]]:
    """Mean sigma and mean error in bins of equally many points by rising sigma."""
    order = np.argsort(sigma, kind="stable")
    parts = np.array_split(order, max(1, min(bins, len(order) // _FEWEST)))
    return np.array([sigma[part].mean() for part in parts]), np.array([error[part].mean() for part in parts])


def _points(rows: Sequence[ObjectRow]) -> tuple[Float[np.ndarray, "n"], Float[np.ndarray, "n"]]:
    sigma = np.concatenate([row.surface_sigma or [] for row in rows])
    return sigma.astype(float), np.concatenate([row.surface_error or [] for row in rows]).astype(float)


def _line(
    axis: Axes,
    entries: Sequence[Entry | None],
    x: Float[np.ndarray, "v"],
    name: str,
    factor: float,
    index: int,
    label: str,
) -> None:
    """One method's medians; an end of an interval that is infinite is drawn to the median alone."""
    middle = np.array([(e or {}).get(name) for e in entries], float) * factor
    ends = [(e or {}).get(f"{name}_interval") or (None, None) for e in entries]
    spread = np.array([[np.nan if end is None else factor * end for end in pair] for pair in ends], float).T
    reach = np.nan_to_num(np.abs(spread - middle))
    axis.errorbar(x, middle, yerr=reach, **_style(index), capsize=3, lw=1.5, label=label)


def _legend(figure: Figure, axis: Axes, columns: int) -> None:
    handles, labels = axis.get_legend_handles_labels()
    figure.legend(
        handles, labels, loc="outside lower center", ncols=min(len(labels), 2 + columns), frameon=False
    )


def _most(entries: Sequence[Entry], category: str) -> int:
    return max(e["n"] for e in entries if e["category"] == category)


def _style(index: int) -> dict[str, Any]:
    """A method's line; those beyond the colours have hollow markers and dashes."""
    again = index >= len(COLORS)
    return {
        "color": COLORS[index % len(COLORS)],
        "marker": _MARKERS[index % len(_MARKERS)],
        "linestyle": "--" if again else "-",
        "markerfacecolor": "white" if again else None,
    }


def faults_plot(rows: Sequence[ObjectRow], methods: Sequence[str], data: str, path: Path) -> bool:
    """Share of correct poses over what is wrong with a scan, in four parts of equally many objects.

    A panel a fault and start. Bars are 95 % Wilson intervals. False, and no picture, where nothing is known to be wrong.
    """
    rows = [row for row in rows if row.conditions]
    if not rows:
        return False
    starts = [start for start in STARTS if any(row.start == start for row in rows)]
    names = list(dict.fromkeys(method_and_start(each)[0] for each in methods))
    figure = Figure(
        figsize=(1.2 + 3.9 * len(_FAULTS), 1.2 + 3.4 * len(starts)), dpi=110, layout="constrained"
    )
    axes = figure.subplots(len(starts), len(_FAULTS), squeeze=False, sharex="col", sharey=True)
    for start, line in zip(starts, axes, strict=True):
        for axis, (fault, factor, label) in zip(line, _FAULTS, strict=True):
            for i, name in enumerate(names):
                chosen = [row for row in rows if (row.method, row.start) == (name, start)]
                if chosen:
                    strength = factor * np.array([getattr(row, fault) for row in chosen], float)
                    shift = 0.012 * (i - (len(names) - 1) / 2)
                    _correct(axis, strength, np.array([row.pose_correct for row in chosen]), shift, i, name)
            axis.set_ylim(0, 1)
            axis.grid(alpha=0.3)
            axis.set_xlabel(label if start == starts[-1] else "")
        line[0].set_ylabel(f"correct 9-DoF poses, {start} start")
    handles = {
        label: handle
        for line in axes
        for handle, label in zip(*line[0].get_legend_handles_labels(), strict=True)
    }
    figure.legend(
        [*handles.values()], [*handles], loc="outside lower center", ncols=len(handles), frameon=False
    )
    figure.suptitle(f"Correct poses over what is wrong with the scan ({data})", fontsize=11)
    finish(figure, None, None, path)
    return True


def _correct(
    axis: Axes,
    strength: Float[np.ndarray, "n"],
    correct: Bool[np.ndarray, "n"],
    shift: float,
    index: int,
    label: str,
) -> None:
    """One method's rates, moved aside by a share of the axis so that bars do not hide each other."""
    parts = np.array_split(np.argsort(strength, kind="stable"), min(_PARTS, len(strength)))
    x, rate = (np.array([values[part].mean() for part in parts]) for values in (strength, correct))
    low, high = np.array([proportion_interval(int(correct[part].sum()), len(part)) for part in parts]).T
    x = x + shift * np.ptp(strength)
    axis.errorbar(
        x, rate, yerr=(rate - low, high - rate), **_style(index), capsize=3, label=label
    )  # fmt: skip


def proportion_interval(count: int, total: int) -> tuple[float, float]:
    """Wilson's 95 % interval of a share."""
    found = binomtest(count, total).proportion_ci(0.95, "wilson")
    return float(found.low), float(found.high)


def reliability_plot(rows: Sequence[ObjectRow], methods: Sequence[str], data: str, path: Path) -> bool:
    """Share of true boxes within each ellipsoid against its probability, of right modes: a panel a number of views.

    Returns whether there was anything to draw.
    """
    views = sorted({row.views for row in rows})
    probabilities = np.linspace(0.01, 0.99, 99)
    figure = Figure(figsize=(1.2 + 3.6 * len(views), 4.2), dpi=110, layout="constrained")
    axes = figure.subplots(1, len(views), squeeze=False, sharey=True)[0]
    drawn = False
    for axis, count in zip(axes, views, strict=True):
        axis.plot([0, 1], [0, 1], color="0.6", linestyle=":", linewidth=1)
        for i, method in enumerate(methods):
            chosen = [row for row in rows if (row.contender, row.views) == (method, count)]
            levels = holding_levels(chosen)
            if not len(levels):
                continue
            held = (levels[:, None] <= probabilities).mean(axis=0)
            axis.plot(
                probabilities, held, color=COLORS[i % len(COLORS)], label=f"{method}, n = {len(levels)}"
            )
            drawn = True
        axis.set_title(f"{count} view{'s' * (count > 1)}")
        axis.set_xlabel("probability of the ellipsoid")
        axis.set_xlim(0, 1)
        axis.set_ylim(0, 1)
        axis.grid(alpha=0.3)
        if axis.get_legend_handles_labels()[0]:
            axis.legend(fontsize=8, loc="upper left")
    axes[0].set_ylabel("share of true boxes inside")
    figure.suptitle(f"Reliability of the 9-DoF box, right modes ({data})", fontsize=11)
    if drawn:
        finish(figure, None, None, path)
    return drawn
