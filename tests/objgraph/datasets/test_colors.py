"""Colour is for display: an image that cannot be used stops nothing, and is warned of once."""

from io import BytesIO

import numpy as np
import pytest
from PIL import Image

from objgraph.datasets import load_scan
from objgraph.datasets.files import decode_color
from tests.fuzz.scans import SCANS
from tests.objgraph.datasets.dataset_folders import (
    color_image,
    png,
    sens_bytes,
    write_sens_scan,
)

IMAGES = {
    "folder": "color/*",
    "tum": "a/rgb/*",
    "nerfstudio": "images/*",
    "bop": "**/rgb/*",
    "scannet": "scannet/**/color/*",
    "sevenscenes": "**/*.color.jpg",
    "icl": "**/image/*",
}
WIDE = np.full((90, 160, 3), 200, np.uint8)


def colors(dataset, root):
    if dataset == "scannet":
        root = root / "scannet"
    scan = load_scan("scannet" if dataset == "sens" else dataset, root)
    return [scan.frames[i].color for i in range(2)]


@pytest.mark.parametrize("dataset", IMAGES)
def test_color_that_is_damaged_or_of_another_view_is_none(dataset, tmp_path, caplog):
    SCANS[dataset][0](tmp_path)
    paths = sorted(tmp_path.glob(IMAGES[dataset]))
    assert len(paths) >= 2
    assert all(color is not None for color in colors(dataset, tmp_path))
    assert "colour" not in caplog.text
    for data, reason in ((b"junk", "no readable image"), (png(WIDE), "the colour image is 160x90 pixels")):
        caplog.clear()
        for path in paths:
            path.write_bytes(data)
        assert colors(dataset, tmp_path) == [None, None]
        (warning,) = [record.getMessage() for record in caplog.records if "colour" in record.msg]
        assert warning.startswith(f"{paths[0]}: {reason}")
        assert warning.endswith("colour is for display, and is not shown where it cannot be used")


def test_so_is_that_of_a_sens_file(tmp_path, caplog):
    data = sens_bytes(2)
    start = data.index(b"\xff\xd8")
    write_sens_scan(tmp_path, data[:start] + bytes(2) + data[start + 2 :])
    first, second = colors("sens", tmp_path)
    assert first is None
    assert second is not None
    assert ".sens: frame 0: no readable image" in caplog.text


def test_a_turn_that_a_camera_notes_is_not_made():
    """Depth and masks know nothing of it."""
    image, exif, turned = Image.fromarray(color_image()), Image.Exif(), BytesIO()
    exif[0x0112] = 6  # a quarter
    image.save(turned, "PNG", exif=exif.tobytes())
    np.testing.assert_array_equal(decode_color(turned.getvalue(), "it"), color_image())
    image.save(jpeg := BytesIO(), "JPEG", exif=exif.tobytes())
    assert decode_color(jpeg.getvalue(), "it").shape == color_image().shape
