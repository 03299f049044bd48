"""Images of masks: what does not keep the values that were written is refused."""

from io import BytesIO

import numpy as np
import pytest
from PIL import Image

from objgraph.datasets import load_scan
from objgraph.errors import DatasetError
from tests.objgraph.datasets.dataset_folders import (
    jpeg,
    mask_image,
    toy_scan,
    write_bop,
    write_plain_folder,
)


def one_bit(mask: np.ndarray) -> bytes:
    """As Pillow writes an array of booleans."""
    Image.fromarray(mask > 0).save(file := BytesIO(), "PNG")
    return file.getvalue()


@pytest.mark.parametrize(
    ("data", "what"),
    [(jpeg(mask_image()), "a mask that is a JPEG"), (one_bit(mask_image()), "a mask of 1 bit")],
    ids=["jpeg", "one_bit"],
)
def test_a_mask_that_does_not_keep_ids_is_refused(tmp_path, data, what):
    folder = write_plain_folder(tmp_path / "toy", toy_scan())
    path = folder / "masks" / "000001.png"
    path.write_bytes(data)
    frames = load_scan("folder", folder).frames
    with pytest.raises(
        DatasetError, match=rf"{path}: {what} does not keep ids; write it as a PNG of 8 or 16"
    ):
        frames[1]
    assert set(np.unique(frames[0].instances)) == {0, 1, 3}


def test_a_palettes_indices_are_to_be_written_as_grey_values(tmp_path):
    folder = write_plain_folder(tmp_path / "toy", toy_scan())
    path = folder / "masks" / "000001.png"
    expected = load_scan("folder", folder).frames[1].instances
    image = Image.fromarray(expected.astype(np.uint8)).convert("P")  # the mode of DAVIS' and VOC's masks
    image.putdata(expected.ravel().tolist())
    image.save(path)
    with pytest.raises(DatasetError, match=rf"{path}: a mask with a palette of colours; write the palette's"):
        load_scan("folder", folder).frames[1]
    Image.fromarray(np.array(Image.open(path))).save(path)
    np.testing.assert_array_equal(load_scan("folder", folder).frames[1].instances, expected)


def test_where_a_mask_is_or_is_not_one_bit_will_do(tmp_path):
    folder = write_bop(tmp_path / "toy", toy_scan())
    expected = load_scan("bop", folder).frames[0].instances
    for path in (folder / "mask_visib").iterdir():
        values = np.asarray(Image.open(path))
        path.write_bytes(one_bit(values))
    np.testing.assert_array_equal(load_scan("bop", folder).frames[0].instances, expected)
