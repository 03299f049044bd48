"""The paper's own figures: table_quantitative_scanet and table_uncertainty on ScanNet, fig_quantitative_kitti on KITTI."""

from objgraph.bench.comparison.objects.rows import method_and_start

LABELS = {
    "node-slam": "Node-SLAM*",
    "dsp-slam": "DSP-SLAM*",
    "ours-det2d": "Ours w/ Det2D",
    "ours-samp2d": "Ours w/ Samp2D",
    "ours": "Ours",
}
"""What the paper calls the methods that it compares, in its order."""


def label(name: str) -> str:
    """A method by its name, and the paper's for it."""
    method = method_and_start(name)[0]
    return f"{name} ({LABELS[method]})" if method in LABELS else name


WHERE = "published, on ScanNet"
"""How its figures are marked."""

OBJECTS = {"chair": 954, "table": 256}
"""Objects that its rates are of."""

UNCERTAINTY_VIEWS = 3
UNCERTAINTY_OBJECTS = {"chair": 145, "table": 17}
"""Well-reconstructed objects that its correlations are the mean of."""

RATES: dict[int, dict[str, dict[str, tuple[float, float, float]]]] = {
    1: {
        "node-slam": {"chair": (0.200, 0.487, 0.555), "table": (0.098, 0.252, 0.359)},
        "dsp-slam": {"chair": (0.224, 0.603, 0.607), "table": (0.105, 0.329, 0.380)},
        "ours-det2d": {"chair": (0.225, 0.631, 0.636), "table": (0.103, 0.339, 0.380)},
        "ours-samp2d": {"chair": (0.226, 0.621, 0.633), "table": (0.140, 0.316, 0.439)},
        "ours": {"chair": (0.214, 0.635, 0.655), "table": (0.123, 0.332, 0.395)},
    },
    2: {
        "node-slam": {"chair": (0.202, 0.505, 0.576), "table": (0.117, 0.248, 0.374)},
        "dsp-slam": {"chair": (0.228, 0.637, 0.634), "table": (0.130, 0.324, 0.382)},
        "ours-det2d": {"chair": (0.236, 0.660, 0.662), "table": (0.119, 0.345, 0.396)},
        "ours-samp2d": {"chair": (0.231, 0.648, 0.666), "table": (0.144, 0.328, 0.432)},
        "ours": {"chair": (0.224, 0.669, 0.656), "table": (0.138, 0.360, 0.430)},
    },
    3: {
        "node-slam": {"chair": (0.215, 0.503, 0.601), "table": (0.140, 0.246, 0.390)},
        "dsp-slam": {"chair": (0.239, 0.657, 0.647), "table": (0.134, 0.338, 0.398)},
        "ours-det2d": {"chair": (0.253, 0.696, 0.695), "table": (0.128, 0.349, 0.417)},
        "ours-samp2d": {"chair": (0.252, 0.675, 0.692), "table": (0.143, 0.339, 0.426)},
        "ours": {"chair": (0.226, 0.682, 0.662), "table": (0.132, 0.332, 0.449)},
    },
}
"""By views, method and category: shares of correct 9-DoF poses, IoU > 0.25 and Chamfer distance < 0.2 m."""

PEARSON: dict[str, dict[str, float]] = {
    "chair": {"ours-det2d": 0.738, "ours-samp2d": 0.740, "ours": 0.749},
    "table": {"ours-det2d": 0.661, "ours-samp2d": 0.668, "ours": 0.742},
}
"""By category and method: correlation of |SDF error| and its standard deviation."""

KITTI_WHERE = "published, on KITTI-3D"
KITTI_OBJECTS = 253
"""Vehicles of the validation set whose detections were within 1 m and 20 degrees."""

BOXES: dict[str, tuple[float, float, float]] = {
    "node-slam": (0.677, 0.786, 0.214),
    "dsp-slam": (0.690, 0.802, 0.257),
    "ours-det2d": (0.721, 0.889, 0.423),
    "ours-samp2d": (0.741, 0.939, 0.537),
    "ours": (0.738, 0.905, 0.549),
}
"""Table III (fig_quantitative_kitti), by method: mean IoU, and shares above 0.6 and 0.75."""
