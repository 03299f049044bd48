"""Masks as SAM and COCO write them: run lengths or polygons in JSON, in place of an image of ids."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from jaxtyping import Bool, UInt16

from objgraph.checked import whole
from objgraph.datasets.files import MOST_PIXELS, read_json
from objgraph.errors import DatasetError

_SLACK_PIXELS, _SLACK = 2, 0.02
"""By how many pixels, or which share of the image, a polygon may reach beyond it, as annotators' do."""


def read_mask_json(path: Path, shape: tuple[int, int]) -> UInt16[np.ndarray, "h w"]:
    """Ids of `[{"segmentation": .., "instance_id": 1}, ..]`, 0 for none; a smaller mask lies over a larger one.

    `segmentation` is COCO's run lengths, `{"size": [h, w], "counts": ..}` (a list or a compressed string), or a list of
    polygons `[x, y, x, y, ..]` in pixels of an image of `shape`. `instance_id`, or `id`, is the object's in all frames.
    The image is as large as the run lengths say.

    Raises:
        DatasetError: the file is none of this, or a mask has no id.
    """
    content = read_json(path)
    if not isinstance(content, list):
        raise DatasetError(f"{path}: must be a list of masks, each with a segmentation and an instance_id")
    masks = [_mask(entry, shape, f"{path}: mask {k}") for k, entry in enumerate(content)]
    sizes = {mask.shape for _, mask in masks}
    if len(sizes) > 1:
        raise DatasetError(f"{path}: its masks are of several sizes: {', '.join(map(str, sorted(sizes)))}")
    ids = np.zeros(sizes.pop() if sizes else shape, np.uint16)
    for identity, mask in sorted(masks, key=lambda each: -int(each[1].sum())):
        ids[mask] = identity
    return ids


def _mask(entry: Any, shape: tuple[int, int], origin: str) -> tuple[int, Bool[np.ndarray, "h w"]]:
    if not isinstance(entry, Mapping) or "segmentation" not in entry:
        raise DatasetError(f"{origin} has no segmentation")
    identity = entry.get("instance_id", entry.get("id"))
    if identity is None:
        raise DatasetError(
            f"{origin} has no instance_id: SAM does not tell which masks of several images are one object; give the same "
            "id to the same object in all frames, or let objgraph segment write the masks"
        )
    if not isinstance(identity, int) or isinstance(identity, bool) or not 0 < identity < 2**16:
        raise DatasetError(f"{origin}: id {identity!r} is none (1 to 65535)")
    segmentation = entry["segmentation"]
    try:
        if isinstance(segmentation, Mapping):
            return identity, decode_rle(segmentation["size"], segmentation["counts"])
        return identity, _polygons(segmentation, shape)
    except (KeyError, TypeError, ValueError, cv2.error) as error:
        raise DatasetError(f"{origin}: its segmentation is damaged ({error})") from error


def decode_rle(size: Sequence[int], counts: Sequence[int] | str) -> Bool[np.ndarray, "h w"]:
    """Runs of outside and inside in turn, down the columns; raises ValueError where they do not fill the image."""
    height, width = (whole(edge) for edge in size)
    if min(height, width) < 1 or height * width > MOST_PIXELS:
        raise ValueError(f"{width}x{height} pixels")
    runs = _decompressed(counts) if isinstance(counts, str) else [whole(count) for count in counts]
    if min(runs, default=0) < 0 or sum(runs) != height * width:
        raise ValueError(f"the runs do not fill {width}x{height} pixels")
    inside = np.arange(len(runs)) % 2 == 1
    return np.repeat(inside, runs).reshape(width, height).T


def _decompressed(text: str) -> list[int]:
    """COCO's string: six bits a character, five of them the number's, least first, with its sign.

    From the fourth on a number is the difference to the last but one.
    """
    runs: list[int] = []
    value = shift = 0
    for character in text:
        bits = ord(character) - 48
        if not 0 <= bits < 64:
            raise ValueError(f"{character!r} in the runs")
        value |= (bits & 0x1F) << shift
        shift += 5
        if bits & 0x20:
            continue
        if bits & 0x10:
            value -= 1 << shift
        runs.append(value + runs[-2] if len(runs) > 2 else value)
        value = shift = 0
    if shift:
        raise ValueError("the runs are cut off")
    return runs


def _polygons(polygons: Any, shape: tuple[int, int]) -> Bool[np.ndarray, "h w"]:
    corners = [np.array(polygon, float).reshape(-1, 2) for polygon in polygons]
    if not corners or any(len(each) < 3 or not np.isfinite(each).all() for each in corners):
        raise ValueError("a polygon has three corners or more")
    edges = np.array(shape[::-1])
    slack = np.maximum(_SLACK_PIXELS, _SLACK * edges)
    for each in corners:
        if ((each < -slack) | (each > edges + slack)).any():
            raise ValueError(
                f"a corner lies outside of {shape[1]}x{shape[0]} pixels: scale polygons to the depth image"
            )
    image = np.zeros(shape, np.uint8)
    for each in corners:  # one after another: together, what two cover would be left out
        cv2.fillPoly(image, [np.round(each).astype(np.int32)], 1)
    return image > 0
