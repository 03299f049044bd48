"""What each factor of a graph costs, as a table and as a picture of the graph."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import gtsam
import numpy as np

from factors.base import ObservationFactor
from factors.keys import readable_key
from factors.state import ObjectKeys
from objgraph.diagnostics.undetermined import require_values


@dataclass(frozen=True)
class FactorCost:
    """One row of the table."""

    index: int
    """In the graph."""
    kind: str
    """GTSAM's class, or the name it was given."""
    keys: tuple[str, ...]
    cost: float
    """Half the squared whitened residual, after a robust loss where there is one."""
    share: float
    """Of the whole graph's cost."""


def observation_names(
    owner: str, slots: Mapping[int, gtsam.NonlinearFactor], factors: Sequence[ObservationFactor]
) -> dict[int, str]:
    """Names of an object's factors that GTSAM's do not fit, by their index in the graph, for `cost_table` and `to_dot`.

    GTSAM calls decoder factors all CustomFactor, and a prior on up a magnetometer. `slots` are the object's factors by index, `factors` those of them that use a
    decoder, in the same order (`ObjectHandle.slots` and `.factors`).
    """
    custom = {i: factor for i, factor in slots.items() if isinstance(factor, gtsam.CustomFactor)}
    indices = sorted(i for i, factor in custom.items() if factor.size() > 1)  # not the mixture of codes
    names = {i: f"{type(factor).__name__} of {owner}" for i, factor in zip(indices, factors, strict=True)}
    upright = {i for i, factor in slots.items() if isinstance(factor, gtsam.MagPoseFactorPose3)}
    return names | dict.fromkeys(upright, f"upright_prior of {owner}")


def cost_table(
    graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, names: Mapping[int, str] | None = None
) -> tuple[FactorCost, ...]:
    """All factors of `graph` at `values`, the dearest first; one whose cost is no number stands before all.

    `names` says by index what a factor is to be called.

    Raises:
        SolveError: a factor's variable is not in the values.
        FactorError: a decoder factor cannot be evaluated; the message names it and its keys.
    """
    require_values(graph, values)
    names = names or {}
    factors = {i: graph.at(i) for i in range(graph.size()) if graph.exists(i)}
    keys = {i: tuple(readable_key(key) for key in list(factor.keys())) for i, factor in factors.items()}
    costs = {i: float(factor.error(values)) for i, factor in factors.items()}
    total = sum(cost for cost in costs.values() if np.isfinite(cost))
    rows = [
        FactorCost(
            i,
            names.get(i, type(factor).__name__),
            keys[i],
            costs[i],
            costs[i] / total if total > 0 else 0.0,
        )
        for i, factor in factors.items()
    ]
    return tuple(sorted(rows, key=lambda row: (-np.inf if np.isnan(row.cost) else -row.cost, row.index)))


def format_table(rows: Sequence[FactorCost], most: int | None = None) -> str:
    """The table as plain text, its first `most` rows."""
    shown = rows[:most]
    cells = [("factor", "kind", "keys", "cost", "share")]
    cells += [
        (str(r.index), r.kind, " ".join(r.keys), f"{r.cost:.4g}", f"{100 * r.share:.1f} %") for r in shown
    ]
    width = [max(len(row[i]) for row in cells) for i in range(5)]
    lines = [
        f"{a:>{width[0]}}  {b:<{width[1]}}  {c:<{width[2]}}  {d:>{width[3]}}  {e:>{width[4]}}"
        for a, b, c, d, e in cells
    ]
    rest = rows[len(shown) :]
    if rest:
        lines.append(f"and {len(rest)} more of {sum(row.cost for row in rest):.4g} together")
    return "\n".join(lines)


def to_dot(
    graph: gtsam.NonlinearFactorGraph,
    values: gtsam.Values,
    names: Mapping[int, str] | None = None,
    objects: Mapping[str, ObjectKeys] | None = None,
) -> str:
    """Graphviz text: variables by readable key, factors by kind and cost, each object's variables in a named frame.

    GTSAM's own `dot` leaves factors without a label. Raises as `cost_table`.
    """
    lines = ["graph {", "  node [fontsize=10];"]
    framed: set[int] = set()
    for i, (name, keys) in enumerate((objects or {}).items()):
        lines += [f"  subgraph cluster_{i} {{", f"    label={_quoted(name)};"]
        lines += [f"    {_quoted(readable_key(key))};" for key in keys]
        lines.append("  }")
        framed.update(keys)
    lines += [f"  {_quoted(readable_key(key))};" for key in graph.keyVector() if key not in framed]
    for row in sorted(cost_table(graph, values, names), key=lambda row: row.index):
        node, label = f"factor{row.index}", _quoted(f"{row.kind}\n{row.cost:.3g}")
        lines.append(f"  {node} [shape=box, style=filled, fillcolor=lightgrey, label={label}];")
        lines += [f"  {node} -- {_quoted(key)};" for key in row.keys]
    return "\n".join([*lines, "}"]) + "\n"


def _quoted(text: str) -> str:
    escaped = text.replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n")
    return f'"{escaped}"'
