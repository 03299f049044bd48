"""How the released programs differ from our own baselines, difference by difference."""

from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Any

from factors.gaussian_depth import Deterministic, Uncentred
from factors.rendering import Renderer
from objgraph.estimate.task import Estimator

Change = Callable[[Any], Any]
"""From an estimator to one with other settings."""


def _set(**changes: Any) -> Change:
    return lambda estimator: replace(estimator, config=replace(estimator.config, **changes))


def _step(**changes: Any) -> Change:
    return lambda estimator: _set(steps=replace(estimator.config.steps, **changes))(estimator)


def _render(renderer: Renderer) -> Change:
    return lambda estimator: replace(estimator, renderer=renderer)


RELEASED_OURS: dict[str, Change] = {
    "code-weight": _set(code_weight=3000.0),
    "clipping": _set(clip=0.1),
    "depth-variance": _render(Uncentred()),
    "band": _step(band=0.025, canonical_band=True, band_samples=20),
    "world-scale": _set(world_scale=True),
    "first-view-depths": _step(first_view_depths=True),
}
"""From `ours`."""
RELEASED_DET2D: dict[str, Change] = {"squared": _render(Deterministic(squared_up_to=0.3))}
"""From `ours-det2d`, in place of the depth's variance."""
STEADY_GN: dict[str, Change] = {"damping": _set(damping=1.0), "huber": _set(huber=0.05)}
"""From `dsp-slam-gn-undamped` to `dsp-slam-gn`. How strongly DSP-SLAM damps and where its Huber weights begin is not known here; the
numbers are ours."""
RELEASED_GN: dict[str, Change] = {
    "iterations": _set(iterations=10),
    "7dof": _set(one_scale=True),
    "one-view": _set(one_view=True),
}
"""From `dsp-slam-gn`."""


def changed(estimator: Estimator, changes: Iterable[Change]) -> Estimator:
    """An estimator with some of the differences."""
    for change in changes:
        estimator = change(estimator)
    return estimator
