"""A ROS 2 bag's metadata.yaml, edited by hand or cut off."""

import re

import pytest

from objgraph.datasets.bag.load import load
from objgraph.errors import DatasetError
from tests.objgraph.datasets.bag_files import write_recording
from tests.objgraph.datasets.dataset_folders import toy_scan

DEPTH, COLOR = "/camera/aligned_depth_to_color/image_raw", "/camera/color/image_raw"


@pytest.mark.parametrize(
    ("line", "becomes", "message"),
    [
        (r"( +)type: \S*CameraInfo", r"\1type:", "has no name or no type"),
        (rf"( +)name: {DEPTH}", r"\1name:", "has no name or no type"),
        (rf"( +)name: {DEPTH}", rf"\1name: {DEPTH} {DEPTH}", "has lost its messages"),
        (rf"( +)name: {COLOR}", rf"\1name: {COLOR} {COLOR}", "has lost its messages; .* map without colour"),
    ],
)
def test_topics_that_are_none_are_told(tmp_path, line, becomes, message):
    path = write_recording(tmp_path, toy_scan(), "db3") / "metadata.yaml"
    text = path.read_text()
    changed = re.sub(line, becomes, text)
    assert changed != text
    path.write_text(changed)
    with pytest.raises(DatasetError, match=message):
        load(tmp_path)
