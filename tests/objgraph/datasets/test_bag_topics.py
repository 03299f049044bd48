"""Which topics of a bag are its images: those of usual cameras are guessed, others are listed."""

import pytest

from objgraph.cli.main import main
from objgraph.datasets.bag.topics import choose
from objgraph.errors import DatasetError
from tests.objgraph.datasets.bag_files import write_recording
from tests.objgraph.datasets.dataset_folders import toy_scan

IMAGE, COMPRESSED = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
CAMERA_INFO, TF = "sensor_msgs/msg/CameraInfo", "tf2_msgs/msg/TFMessage"


@pytest.mark.parametrize(
    ("topics", "expected"),
    [
        (
            {
                "/camera/depth/image": IMAGE,
                "/camera/rgb/image_color": IMAGE,
                "/camera/depth/camera_info": CAMERA_INFO,
                "/camera/rgb/camera_info": CAMERA_INFO,
            },
            ("/camera/depth/image", "/camera/rgb/image_color", "/camera/depth/camera_info"),
        ),
        (
            {
                "/k4a/depth_to_rgb/image_raw": IMAGE,
                "/k4a/depth/image_raw": IMAGE,
                "/k4a/rgb/image_raw": IMAGE,
                "/k4a/rgb/camera_info": CAMERA_INFO,
                "/k4a/depth/camera_info": CAMERA_INFO,
            },
            ("/k4a/depth_to_rgb/image_raw", "/k4a/rgb/image_raw", "/k4a/rgb/camera_info"),
        ),
        (
            {
                "/depth/image_rect/compressedDepth": COMPRESSED,
                "/rgb/image/compressed": COMPRESSED,
                "/rgb/image_rect/compressed": COMPRESSED,
                "/only/camera_info": CAMERA_INFO,
            },
            ("/depth/image_rect/compressedDepth", "/rgb/image_rect/compressed", "/only/camera_info"),
        ),
    ],
)
def test_topics_of_usual_cameras_are_guessed(topics, expected):
    chosen = choose(topics, "bag")
    assert (chosen.depth, chosen.color, chosen.info) == expected


@pytest.mark.parametrize(
    ("topics", "named", "message"),
    [
        ({}, {}, r"no topic of depth; name one by depth_topic \(--topic\.depth\); it has none"),
        ({"/a/depth": IMAGE, "/b/depth": IMAGE}, {}, r"2 topics may be its depth: /a/depth, /b/depth"),
        ({"/depth": IMAGE}, {}, r"no topic of info; .* it has /depth \(Image\)"),
        ({"/depth": IMAGE}, {"depth_topic": "/d"}, r"no topic of info"),
        ({"/i": CAMERA_INFO}, {"depth_topic": "/d"}, r"/d, named as depth, has no messages"),
        (
            {"/i": CAMERA_INFO},
            {"depth_topic": "/i"},
            r"/i, named as depth, is of type sensor_msgs/msg/CameraInfo",
        ),
        ({"/depth": IMAGE, "/i": CAMERA_INFO}, {"pose_topic": "/i"}, r"/i, named as pose, is of type"),
    ],
)
def test_topics_that_are_not_clear_are_listed(topics, named, message):
    with pytest.raises(DatasetError, match=message):
        choose(topics, "bag", **named)


@pytest.mark.parametrize("words", [["doctor"], ["sensor", "--out", "{}/sensor.json"]])
def test_commands_take_the_topics_that_errors_name(words, tmp_path, capsys):
    write_recording(tmp_path / "robot", toy_scan(2))
    words = [*(word.replace("{}", str(tmp_path)) for word in words), "--dataset", "bag"]
    assert main([*words, "--root", str(tmp_path / "robot"), "--topic.depth", "/nowhere"]) == 1
    said = capsys.readouterr()
    assert "/nowhere, named as depth, has no messages" in said.out + said.err
