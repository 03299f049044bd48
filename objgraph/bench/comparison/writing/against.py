"""What each method is set against: the graph from the same start."""

from collections.abc import Sequence

GRAPH = "graph"


def against(names: Sequence[str]) -> list[tuple[str, str]]:
    """Pairs of a reference and another one: the graph that begins where the other does (`NAME@START`), else any graph.

    Without a graph the first one is the reference.
    """
    graphs = [name for name in names if name.partition("@")[0] == GRAPH] or [*names[:1]]

    def reference(name: str) -> str:
        own = GRAPH + "".join(name.partition("@")[1:])
        return own if own in graphs and own != name else graphs[0]

    return [(first, name) for name in names if (first := reference(name)) != name]
