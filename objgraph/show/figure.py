"""The frame of a picture: panels in a row, a colour bar in centimetres, labels, and a PNG of bounded size."""

import io
from collections.abc import Sequence
from pathlib import Path
from typing import cast

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.text import Text
from PIL import Image

from objgraph.atomic import write_file
from objgraph.maps.colors import sigma_colormap

_BYTES = 950_000
"""A picture's file is made smaller than this."""
_LABEL = (7.0, 20.0)
"""Width of a label's letter and height of its box, pixels."""


def panels(
    width: int, size: tuple[int, int], columns: int, title: str, limit: float | None
) -> tuple[Figure, list[Axes], Axes | None]:
    """A figure with one axis a picture, of the pictures' own size, and a narrow one for the colour bar."""
    dpi, head = 100, 64
    height = size[1] + head + 12
    figure = Figure(figsize=(width / dpi, height / dpi), dpi=dpi, facecolor="white")
    gap = (width * 93 // 100 - columns * size[0]) / (columns + 1)
    axes = [
        figure.add_axes(
            (
                (gap + i * (size[0] + gap)) / width,
                12 / height,
                size[0] / width,
                size[1] / height,
            )
        )
        for i in range(columns)
    ]
    figure.text(gap / width, 1 - 22 / height, title, fontsize=14, weight="bold", va="center")
    bar = figure.add_axes((0.935, 0.14, 0.012, 0.66)) if limit is not None else None
    return figure, axes, bar


def show(axis: Axes, picture: Float[np.ndarray, "h w 3"], title: str) -> None:
    """Put a picture into its panel, pixel for pixel."""
    axis.imshow(picture, interpolation="none", aspect="auto")
    axis.set_title(title, fontsize=10, color="0.35", pad=3)
    axis.set_xticks([])
    axis.set_yticks([])
    for spine in axis.spines.values():
        spine.set_color("0.85")


def label(axis: Axes, texts: Sequence[str], uv: Float[np.ndarray, "n 2"]) -> None:
    """Write each text at its pixel, or above what it would cover there; below, where the panel has no room above."""
    boxes: list[tuple[float, float, float]] = []
    for i in np.argsort(-uv[:, 1]):
        (u, v), half, up = uv[i], (len(texts[i]) + 1) * _LABEL[0] / 2, True
        while clash := [b for b in boxes if abs(b[0] - u) < b[2] + half and abs(b[1] - v) < _LABEL[1]]:
            above = min(b[1] for b in clash) - _LABEL[1] - 1
            up = up and above > _LABEL[1] / 2
            v = above if up else max(b[1] for b in clash) + _LABEL[1] + 1
        boxes.append((u, v, half))
        box = {"boxstyle": "round,pad=0.25", "facecolor": "white", "edgecolor": "0.5", "alpha": 0.85}
        axis.text(u, v, str(texts[i]), fontsize=9, ha="center", va="center", clip_on=True, bbox=box)


def finish(figure: Figure, bar: Axes | None, limit: float | None, path: Path) -> None:
    """Draw the colour bar from 0 to `limit` metres and write the file, all texts as they are; raises OutputError."""
    if bar is not None and limit is not None:
        mappable = ScalarMappable(Normalize(0, 100 * limit), sigma_colormap())
        figure.colorbar(mappable, cax=bar, extend="max")
        bar.set_ylabel("standard deviation of the surface (cm)", fontsize=10)
    for text in figure.findobj(Text):
        cast(Text, text).set_parse_math(False)  # a name may hold dollars
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png")
    _write_png(path, Image.open(buffer).convert("RGB"))


def _write_png(path: Path, image: Image.Image) -> None:
    """In 256 colours, then smaller, where the file would be too large."""
    data = _png(image)
    while len(data) > _BYTES:
        data = _png(image.quantize(256, dither=Image.Dither.NONE))
        image = image.resize((image.width * 9 // 10, image.height * 9 // 10), Image.Resampling.LANCZOS)
    write_file(path, data)


def _png(image: Image.Image) -> bytes:
    buffer = io.BytesIO()
    image.save(buffer, format="PNG")
    return buffer.getvalue()
