"""Where a program's time goes, as a picture: python -m tests.benchmarks.flame STACKS PICTURE

STACKS is what `py-spy record -f raw -o STACKS -- python -m objgraph.cli -q map --dataset sample --jobs 1 --out OUT` writes: lines of
frames and a count. Frames of the project alone are drawn; what they call elsewhere is theirs.
"""

import re
import sys
from dataclasses import dataclass, field
from pathlib import Path

import matplotlib
import matplotlib.pyplot as plt
from matplotlib.patches import Rectangle

_FRAME = re.compile(r"^(?P<name>.*) \((?:.*/)?(?P<file>(?:objgraph|factors)/[\w/]+\.py):\d+\)$")
_HIDDEN = ("<listcomp>", "<lambda>", "<genexpr>", "<dictcomp>", "_guarded")
_LEAST = 0.004
"""Share of the whole below which a frame is not drawn."""


@dataclass
class Node:
    name: str
    count: int = 0
    children: dict[str, "Node"] = field(default_factory=dict)


def read(path: Path) -> Node:
    root = Node("all")
    for line in path.read_text().splitlines():
        stack, _, count = line.rpartition(" ")
        node = root
        node.count += int(count)
        for frame in stack.split(";"):
            found = _FRAME.match(frame)
            if (
                found is None
                or found["name"].split(".")[-1] in _HIDDEN
                or found["file"].endswith("__main__.py")
            ):
                continue
            name = f"{found['name']}\n{found['file']}" if found["name"] != "<module>" else "import\n"
            if name == node.name:
                continue
            node = node.children.setdefault(name, Node(name))
            node.count += int(count)
    return root


def draw(root: Node, path: Path) -> None:
    matplotlib.use("Agg")
    figure, axes = plt.subplots(figsize=(15, 8.5), layout="constrained")
    colors = {
        "objgraph/graph": "#f2c14e",
        "objgraph/estimate": "#f2c14e",
        "factors": "#e07a5f",
        "objgraph": "#a8c5da",
    }
    deepest = 0

    def place(node: Node, left: float, depth: int) -> None:
        nonlocal deepest
        width = node.count / root.count
        if width < _LEAST:
            return
        deepest = max(deepest, depth)
        name, _, file = node.name.partition("\n")
        color = next((c for folder, c in colors.items() if file.startswith(folder)), "#dddddd")
        axes.add_patch(
            Rectangle((left, depth), width, 0.94, facecolor=color, edgecolor="white", linewidth=0.6)
        )
        label = f"{name.split('.')[-1]} {100 * width:.0f}%" if width > 0.03 else name.split(".")[-1]
        if width > 0.0045 * len(label):
            axes.text(left + width / 2, depth + 0.47, label, ha="center", va="center", fontsize=8)
        for child in sorted(node.children.values(), key=lambda each: -each.count):
            place(child, left, depth + 1)
            left += child.count / root.count

    place(root, 0.0, 0)
    axes.set(xlim=(0, 1), ylim=(0, deepest + 1))
    axes.set_axis_off()
    figure.savefig(path, dpi=110)


if __name__ == "__main__":
    draw(read(Path(sys.argv[1])), Path(sys.argv[2]))
