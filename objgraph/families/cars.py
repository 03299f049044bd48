"""Cars of nine styles: a body of drawn parameters and what is mounted on it."""

from collections.abc import Callable

import trimesh
from numpy.random import Generator

from objgraph.families import car_parts
from objgraph.families.car_body import CarShape, body
from objgraph.families.car_styles import draw_shape
from objgraph.families.parts import canonical

Extra = Callable[[Generator, CarShape], list[trimesh.Trimesh]]

_EXTRAS: dict[str, list[tuple[Extra, float]]] = {
    "sedan": [(car_parts.roof_sign, 0.3), (car_parts.spoiler, 0.15)],
    "hatchback": [(car_parts.roof_spoiler, 0.3), (car_parts.roof_sign, 0.1)],
    "estate": [(car_parts.roof_rails, 0.5), (car_parts.roof_spoiler, 0.2), (car_parts.roof_sign, 0.15)],
    "suv": [
        (car_parts.roof_rails, 0.35),
        (car_parts.spare_wheel, 0.25),
        (car_parts.side_steps, 0.3),
        (car_parts.roof_sign, 0.15),
        (car_parts.roof_spoiler, 0.15),
    ],
    "van": [(car_parts.roof_rails, 0.1), (car_parts.side_steps, 0.1), (car_parts.roof_sign, 0.08)],
    "minivan": [(car_parts.roof_rails, 0.25), (car_parts.roof_spoiler, 0.2), (car_parts.roof_sign, 0.1)],
    "pickup": [(car_parts.side_steps, 0.25), (car_parts.roof_sign, 0.15)],
    "sports": [(car_parts.spoiler, 0.45), (car_parts.roof_sign, 0.05)],
    "toy": [(car_parts.roof_sign, 0.3), (car_parts.spoiler, 0.1), (car_parts.roof_rails, 0.1)],
}
_ANYWHERE: list[tuple[Extra, float]] = [
    (car_parts.mirrors, 0.6),
    (car_parts.bumpers, 0.4),
    (car_parts.flares, 0.15),
]


def sedan(rng: Generator) -> trimesh.Trimesh:
    """A car with bonnet, cabin and boot."""
    return _car(rng, "sedan")


def hatchback(rng: Generator) -> trimesh.Trimesh:
    """A short car whose rear window ends at the tail."""
    return _car(rng, "hatchback")


def estate(rng: Generator) -> trimesh.Trimesh:
    """A car whose roof reaches to the tail."""
    return _car(rng, "estate")


def suv(rng: Generator) -> trimesh.Trimesh:
    """A tall estate on large wheels."""
    return _car(rng, "suv")


def van(rng: Generator) -> trimesh.Trimesh:
    """A box with a short bonnet or none."""
    return _car(rng, "van")


def minivan(rng: Generator) -> trimesh.Trimesh:
    """A family car with a short sloping bonnet and a long roof."""
    return _car(rng, "minivan")


def pickup(rng: Generator) -> trimesh.Trimesh:
    """A cabin and an open bed."""
    return _car(rng, "pickup")


def sports(rng: Generator) -> trimesh.Trimesh:
    """A low, wide car with a small cabin."""
    return _car(rng, "sports")


def toy(rng: Generator) -> trimesh.Trimesh:
    """A short, tall car on large wheels, as in games."""
    return _car(rng, "toy")


def _car(rng: Generator, style: str) -> trimesh.Trimesh:
    shape = draw_shape(rng, style)
    parts = [*body(shape), *car_parts.wheels(rng, shape)]
    for extra, probability in _ANYWHERE + _EXTRAS[style]:
        if rng.random() < probability:
            parts += extra(rng, shape)
    return canonical(parts)
