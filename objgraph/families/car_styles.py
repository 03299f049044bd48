"""Styles of cars as ranges of the body's parameters, and shapes drawn from them and between them."""

from dataclasses import fields

from numpy.random import Generator

from objgraph.families.car_body import CarShape

Range = tuple[float, float]

_COMMON: dict[str, Range] = {
    "length": (3.7, 4.9),
    "width": (1.65, 2.15),
    "height": (1.35, 1.65),
    "clearance": (0.15, 0.40),
    "wheel_radius": (0.27, 0.38),
    "wheel_width": (0.17, 0.32),
    "wheel_inset": (-0.05, 0.10),
    "front_axle": (0.16, 0.23),
    "rear_axle": (0.77, 0.84),
    "nose_height": (0.42, 0.58),
    "cowl_height": (0.51, 0.68),
    "deck_height": (0.51, 0.70),
    "tail_height": (0.48, 0.68),
    "cowl": (0.24, 0.34),
    "screen_top": (0.38, 0.48),
    "roof_end": (0.66, 0.76),
    "deck": (0.78, 0.90),
    "nose_lean": (0.0, 0.20),
    "tail_lean": (-0.05, 0.15),
    "nose_length": (0.03, 0.20),
    "tail_length": (0.03, 0.15),
    "nose_width": (0.60, 1.0),
    "tail_width": (0.70, 1.0),
    "nose_drop": (0.0, 0.14),
    "tail_drop": (0.0, 0.08),
    "nose_rise": (-0.05, 0.12),
    "tail_rise": (0.0, 0.16),
    "end_exponent": (1.5, 3.5),
    "tumblehome": (0.08, 0.30),
    "belt_width": (0.88, 1.0),
    "roof_taper": (0.0, 0.10),
    "roof_slope": (-0.03, 0.10),
    "roof_crown": (0.0, 0.08),
    "screen_bow": (1.0, 1.6),
    "corner": (4.5, 24.0),
    "sill_inset": (0.0, 0.14),
    "shoulder_inset": (0.0, 0.10),
    "body_crown": (0.0, 0.06),
    "edge": (0.0, 0.14),
    "arch": (1.05, 1.28),
    "arch_exponent": (1.8, 3.0),
    "bed_front": (0.55, 0.62),
    "bed_depth": (0.0, 0.0),
}

STYLES: dict[str, dict[str, Range]] = {
    "sedan": {"deck": (0.76, 0.88), "roof_end": (0.62, 0.77)},
    "hatchback": {
        "length": (3.4, 4.4),
        "height": (1.38, 1.7),
        "roof_end": (0.76, 0.90),
        "deck": (0.93, 0.995),
        "deck_height": (0.58, 0.74),
        "tail_height": (0.55, 0.70),
        "roof_slope": (0.0, 0.16),
    },
    "estate": {
        "length": (4.2, 5.0),
        "roof_end": (0.86, 0.95),
        "deck": (0.95, 1.0),
        "tail_length": (0.02, 0.08),
        "roof_slope": (0.0, 0.12),
    },
    "suv": {
        "length": (3.7, 4.9),
        "width": (1.75, 2.25),
        "height": (1.6, 2.0),
        "clearance": (0.25, 0.70),
        "wheel_radius": (0.33, 0.47),
        "nose_height": (0.50, 0.64),
        "cowl_height": (0.58, 0.70),
        "deck_height": (0.56, 0.70),
        "screen_top": (0.36, 0.46),
        "roof_end": (0.85, 0.98),
        "deck": (0.95, 1.0),
        "nose_lean": (-0.05, 0.12),
        "tail_length": (0.01, 0.08),
        "tail_width": (0.8, 1.0),
        "tumblehome": (0.03, 0.24),
    },
    "van": {
        "length": (4.0, 5.3),
        "width": (1.75, 2.3),
        "height": (1.8, 2.35),
        "wheel_radius": (0.30, 0.42),
        "front_axle": (0.14, 0.22),
        "nose_height": (0.36, 0.52),
        "cowl_height": (0.46, 0.60),
        "deck_height": (0.45, 0.60),
        "tail_height": (0.45, 0.60),
        "cowl": (0.03, 0.22),
        "screen_top": (0.14, 0.34),
        "roof_end": (0.94, 0.985),
        "deck": (0.98, 1.0),
        "tail_length": (0.01, 0.05),
        "tail_width": (0.88, 1.0),
        "tumblehome": (0.0, 0.16),
        "belt_width": (0.93, 1.0),
        "corner": (8.0, 40.0),
        "roof_slope": (-0.03, 0.04),
        "tail_lean": (-0.03, 0.05),
    },
    "minivan": {
        "length": (3.9, 4.9),
        "height": (1.55, 1.9),
        "nose_height": (0.42, 0.54),
        "cowl_height": (0.53, 0.64),
        "deck_height": (0.54, 0.66),
        "cowl": (0.10, 0.24),
        "screen_top": (0.30, 0.44),
        "roof_end": (0.82, 0.95),
        "deck": (0.95, 1.0),
        "tail_length": (0.02, 0.1),
        "roof_slope": (0.0, 0.12),
    },
    "pickup": {
        "length": (4.5, 5.6),
        "width": (1.75, 2.2),
        "height": (1.55, 1.95),
        "clearance": (0.25, 0.60),
        "wheel_radius": (0.32, 0.46),
        "nose_height": (0.50, 0.62),
        "cowl_height": (0.58, 0.68),
        "deck_height": (0.56, 0.66),
        "tail_height": (0.55, 0.66),
        "cowl": (0.22, 0.32),
        "screen_top": (0.31, 0.41),
        "roof_end": (0.48, 0.64),
        "deck": (0.50, 0.68),
        "tail_length": (0.005, 0.02),
        "tail_width": (0.95, 1.0),
        "tail_drop": (0.0, 0.02),
        "tail_lean": (-0.02, 0.03),
        "bed_front": (0.52, 0.70),
        "bed_depth": (0.25, 0.55),
    },
    "sports": {
        "length": (3.9, 4.9),
        "width": (1.75, 2.3),
        "height": (1.05, 1.35),
        "clearance": (0.10, 0.28),
        "wheel_radius": (0.28, 0.37),
        "wheel_width": (0.2, 0.36),
        "nose_height": (0.44, 0.58),
        "cowl_height": (0.58, 0.70),
        "deck_height": (0.60, 0.78),
        "tail_height": (0.58, 0.76),
        "cowl": (0.22, 0.42),
        "screen_top": (0.40, 0.56),
        "roof_end": (0.58, 0.74),
        "deck": (0.72, 0.94),
        "nose_lean": (0.0, 0.3),
        "nose_length": (0.06, 0.25),
        "nose_drop": (0.0, 0.2),
        "tumblehome": (0.12, 0.34),
        "screen_bow": (1.0, 2.0),
    },
    "toy": {
        "length": (2.4, 3.6),
        "width": (1.5, 2.0),
        "height": (1.35, 2.0),
        "clearance": (0.15, 0.45),
        "wheel_radius": (0.30, 0.48),
        "wheel_width": (0.2, 0.42),
        "wheel_inset": (-0.15, 0.08),
        "nose_height": (0.42, 0.58),
        "cowl_height": (0.48, 0.64),
        "deck_height": (0.48, 0.64),
        "tail_height": (0.44, 0.62),
        "roof_end": (0.66, 0.92),
        "deck": (0.76, 0.985),
        "nose_width": (0.8, 1.0),
        "tail_width": (0.85, 1.0),
        "nose_length": (0.02, 0.1),
        "tail_length": (0.02, 0.1),
        "corner": (6.0, 40.0),
        "edge": (0.0, 0.2),
    },
}
"""Ranges of a style's parameters where they differ from the common ones."""

_MIXED = 0.5
"""Share of the cars that are mixtures of two styles."""
_SOLID = 0.25
"""Share of the cars without hollow wheel arches."""


def draw_shape(rng: Generator, style: str) -> CarShape:
    """Parameters of a style, half of the time moved towards those of another."""
    values = _draw(rng, style)
    if rng.random() < _MIXED:
        # a pick-up's bed cannot be half there
        others = [name for name in STYLES if (name == "pickup") == (style == "pickup")]
        share, other = rng.uniform(0.0, 0.5), _draw(rng, str(rng.choice(others)))
        values = {key: (1 - share) * value + share * other[key] for key, value in values.items()}
    if rng.random() < _SOLID:
        values["arch"] = 0.0
    if style == "pickup":
        values["bed_front"] = max(values["bed_front"], values["deck"] + 0.01)
        rim = min(values["deck_height"], values["tail_height"]) * values["height"]
        values["clearance"] = min(values["clearance"], 0.55 * rim)
        values["bed_depth"] = min(values["bed_depth"], 0.6 * (rim - values["clearance"]))
    values["screen_top"] = max(values["screen_top"], values["cowl"] + 0.02)
    values["deck"] = max(values["deck"], values["roof_end"] + 0.005)
    return CarShape(**values)


def _draw(rng: Generator, style: str) -> dict[str, float]:
    ranges = _COMMON | STYLES[style]
    return {field.name: rng.uniform(*ranges[field.name]) for field in fields(CarShape)}
