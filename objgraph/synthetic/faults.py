"""What is wrong with a scan, by difficulty: each fault's strength is drawn for every object, so that a set has easy and hard ones."""

from dataclasses import asdict, dataclass, fields
from typing import Any, Literal, get_args

import numpy as np
from numpy.random import Generator

from objgraph.errors import DatasetError

Difficulty = Literal["clean", "everyday", "hard"]
Range = tuple[float, float]
IMAGE_WIDTH = 640
"""Pixels are those of an image this wide; a narrower one has as many fewer."""


@dataclass(frozen=True)
class FaultRanges:
    """Between which strengths each fault is drawn, evenly. The defaults are those of `everyday`.

    Depth: Sarbolandi, Lefloch, Kolb, "Kinect range sensing", CVIU 2015. Masks: Cheng, Girshick, Dollar, Berg, Kirillov,
    "Boundary IoU", CVPR 2021, and Kirillov, Wu, He, Girshick, "PointRend", CVPR 2020. Cameras: Dai, Niessner, Zollhofer,
    Izadi, Theobalt, "BundleFusion", ToG 2017. Occlusion and clutter: Avetisyan et al., "Scan2CAD", CVPR 2019.
    """

    visible: Range = (0.35, 0.6)
    """Share of the object's outer surface that all views together see: what one side shows, less what stands before it."""
    distance_m: Range = (1.0, 2.5)
    """From the first camera to the object's middle; before a large table it is what a person keeps from its edge."""
    aim_m: Range = (0.05, 0.15)
    """Standard deviation of where the camera looks about the object's middle: objects are cut by the picture's border."""
    pushed: float = 0.2
    """Share of the chairs that are pushed under a table, and of the tables that have a chair under them."""
    things_on: Range = (0.0, 2.0)
    """How many things stand on the object or lie on it."""
    apart_deg: Range = (10.0, 20.0)
    """Degrees about the object from one view to the next."""
    walk: float = 0.3
    """Share of the objects that are walked past instead."""
    walk_m: Range = (0.2, 0.5)
    """From one view to the next, walking past."""
    mask_border_px: Range = (2.0, 4.0)
    """Root mean square length of the displacement of masks' pixels, over both axes: a border moves across itself by 0.71 of it
    (Boundary IoU: what masks of networks are worst at)."""
    mask_thin_px: Range = (0.0, 3.0)
    """Parts that no disc of this width fits in are missing from masks, as legs are (PointRend: masks are upsampled from 28 x 28 cells)."""
    mask_part: Range = (0.0, 0.1)
    """Share of a mask that is missing, or as much taken from what is beside it; in every view another part."""
    merged: float = 0.05
    """Share of the objects whose mask is one with that of a neighbour it touches in the picture."""
    sensor: Range = (1.0, 1.5)
    """Factor on the sensor model's noise, steps and lost edges (Nguyen et al. 2012)."""
    flying: Range = (0.0, 0.2)
    """Share of the pixels with depth at edges of the true depth that lie between what is before and what is behind (Sarbolandi et al.)."""
    holes: Range = (0.0, 0.1)
    """Share of the object's surface, of what is seen from outside, that is dark or shiny and gives no depth (Sarbolandi et al.)."""
    fusion_px: Range = (0.0, 1.5)
    """Standard deviation over which depth is smoothed, as by fusion into voxels of centimetres (BundleFusion)."""
    camera_m: Range = (0.0, 0.01)
    """Error of every camera's place (BundleFusion: 0.5 to 2 cm on hand-held sequences)."""
    camera_deg: Range = (0.0, 0.5)
    """Error of every camera's rotation."""
    floor_m: Range = (-0.01, 0.01)
    """By how much the floor that is seen is higher than what the object stands on."""

    def draw(self, rng: Generator) -> "Faults":
        """One object's strengths, by fields in their order; a share is drawn as yes or no."""
        drawn = {}
        for field in fields(self):
            value, chance = getattr(self, field.name), float(rng.random())
            if isinstance(value, tuple):
                low, high = value
                drawn[field.name] = low + (high - low) * chance
            else:
                drawn[field.name] = bool(chance < value)
        return Faults(**drawn)


@dataclass(frozen=True)
class Faults:
    """One object's strengths; see `FaultRanges`."""

    visible: float
    distance_m: float
    aim_m: float
    pushed: bool
    things_on: float
    apart_deg: float
    walk: bool
    walk_m: float
    mask_border_px: float
    mask_thin_px: float
    mask_part: float
    merged: bool
    sensor: float
    flying: float
    holes: float
    fusion_px: float
    camera_m: float
    camera_deg: float
    floor_m: float


EVERYDAY = FaultRanges()
"""A careful user's scan."""
HARD = FaultRanges(
    visible=(0.2, 0.6), distance_m=(1.0, 3.5), aim_m=(0.05, 0.25), pushed=0.4, things_on=(0.0, 3.0), apart_deg=(5.0, 20.0),
    walk=0.5, walk_m=(0.15, 0.5), mask_border_px=(2.0, 8.0), mask_thin_px=(0.0, 6.0), mask_part=(0.0, 0.15), merged=0.1,
    sensor=(1.0, 2.0), flying=(0.0, 0.4), holes=(0.0, 0.15), fusion_px=(0.0, 3.0), camera_m=(0.0, 0.02),
    camera_deg=(0.0, 1.0), floor_m=(-0.02, 0.02),
)  # fmt: skip
"""What ScanNet is like."""


def ranges_of(difficulty: str) -> FaultRanges | None:
    """The ranges of a difficulty; None for `clean`. Raises `DatasetError` for another word."""
    known: dict[str, FaultRanges | None] = {"clean": None, "everyday": EVERYDAY, "hard": HARD}
    if difficulty not in known:
        raise DatasetError(f"no difficulty '{difficulty}'; there are {', '.join(get_args(Difficulty))}")
    return known[difficulty]


def faults_from(values: Any, difficulty: str) -> FaultRanges:
    """The difficulty's ranges with those of a JSON object in their place: pairs of numbers, or shares.

    Raises `DatasetError` where it is none, names an unknown fault, or the difficulty has no faults.
    """
    ranges = ranges_of(difficulty)
    if ranges is None:
        raise DatasetError("clean scans have no faults: choose another difficulty")
    known = asdict(ranges)
    if not isinstance(values, dict) or (wrong := sorted(set(values) - set(known))):
        named = f"'{wrong[0]}' is none" if isinstance(values, dict) else "a JSON object is expected"
        raise DatasetError(f"no faults: {named}; they are {', '.join(known)}")
    for name, value in values.items():
        pair = isinstance(known[name], tuple)
        numbers: list[Any] = value if pair and isinstance(value, list) else [value]
        if len(numbers) != 1 + pair or not all(type(x) in (int, float) and abs(x) < 100 for x in numbers):
            raise DatasetError(
                f"{name}: {'two numbers are' if pair else 'a share is'} expected, not {value!r}"
            )
        known[name] = tuple(numbers) if pair else numbers[0]
    return FaultRanges(**known)


def pixels(strength: float, width: int) -> float:
    """A strength in the pixels of an image of some width."""
    return strength * width / IMAGE_WIDTH


def unit(rng: Generator) -> np.ndarray:
    """A random direction."""
    direction = rng.normal(size=3)
    return direction / np.linalg.norm(direction)
