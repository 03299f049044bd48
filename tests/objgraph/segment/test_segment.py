"""The segmentation front-end: loading, the way of a mask through padding and scaling, and ids over frames."""

import json
import shutil
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from objgraph.cli.main import main
from objgraph.datasets.kitti import load_frame
from objgraph.datasets.registry import load_scan
from objgraph.errors import SegmentationError
from objgraph.observation.frames import Frame, FrameSource, Intrinsics
from objgraph.segment import Segment, SegmentConfig, Segmenter, detection_masks, instance_masks
from objgraph.segment.link import LinkConfig, link
from objgraph.synthetic.street import StreetConfig, ensure_street

transformers = pytest.importorskip("transformers", reason="install it with: pip install 'objgraph[segment]'")

LABELS = {0: "chair", 1: "dining table", 2: "zebra"}


@pytest.fixture(scope="module")
def checkpoint(tmp_path_factory):
    """The real network, tiny and at random."""
    torch.manual_seed(0)
    stages = ["stage1", "stage2", "stage3", "stage4"]
    backbone = transformers.SwinConfig(
        image_size=64,
        embed_dim=8,
        depths=[1, 1, 1, 1],
        num_heads=[1, 1, 2, 2],
        window_size=4,
        out_features=stages,
    )
    config = transformers.Mask2FormerConfig(
        backbone_config=backbone, feature_size=32, mask_feature_size=32, hidden_dim=32, encoder_layers=1,
        decoder_layers=2, num_attention_heads=2, dim_feedforward=32, encoder_feedforward_dim=32, num_queries=8,
        id2label=LABELS, label2id={name: i for i, name in LABELS.items()},
    )  # fmt: skip
    folder = tmp_path_factory.mktemp("weights")
    transformers.Mask2FormerForUniversalSegmentation(config).save_pretrained(folder)
    (folder / "preprocessor_config.json").write_text('{"size": {"shortest_edge": 64, "longest_edge": 100}}')
    return folder


def test_the_real_network_is_loaded_and_runs(checkpoint):
    segmenter = Segmenter.load(checkpoint, SegmentConfig(threshold=0.0, min_pixels=1))
    color = np.random.default_rng(0).integers(0, 255, (60, 90, 3)).astype(np.uint8)
    segments = segmenter.segment(color)
    assert segments
    assert {each.category for each in segments} <= {"chair", "table"}  # what we have no use for is left out
    assert all(each.mask.shape == (60, 90) for each in segments)
    assert np.sum([each.mask for each in segments], axis=0).max() == 1
    assert [each.score for each in segments] == sorted((each.score for each in segments), reverse=True)
    again = Segmenter.load(checkpoint, SegmentConfig(threshold=0.0, min_pixels=1)).segment(color)
    assert all(np.array_equal(a.mask, b.mask) for a, b in zip(segments, again, strict=True))


def test_weights_that_are_not_there_or_none(checkpoint, tmp_path):
    with pytest.raises(SegmentationError, match=r"no Mask2Former weights here .* hf download"):
        Segmenter.load(tmp_path)
    with pytest.raises(SegmentationError, match="no Mask2Former weights here"):
        Segmenter.load("facebook/mask2former-swin-small-coco-instance-that-nobody-has")
    (tmp_path / "config.json").write_text((checkpoint / "config.json").read_text())
    (tmp_path / "model.safetensors").write_bytes(b"no weights")
    with pytest.raises(SegmentationError, match="no Mask2Former weights here"):
        Segmenter.load(tmp_path)
    from safetensors.torch import save_file

    save_file({"other": torch.zeros(1)}, tmp_path / "model.safetensors", metadata={"format": "pt"})
    with pytest.raises(SegmentationError, match="is no Mask2Former checkpoint, it lacks"):
        Segmenter.load(tmp_path)


def test_a_pickled_checkpoint_is_not_read(checkpoint, tmp_path):
    (tmp_path / "config.json").write_text((checkpoint / "config.json").read_text())
    torch.save({"x": torch.zeros(1)}, tmp_path / "pytorch_model.bin")
    with pytest.raises(SegmentationError, match="no Mask2Former weights here"):
        Segmenter.load(tmp_path)


def test_without_transformers_it_says_what_to_install(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "transformers", None)
    with pytest.raises(SegmentationError, match=r"pip install 'objgraph\[segment\]'"):
        Segmenter.load("anything")


class Network(torch.nn.Module):
    """Answers with masks of the image's bright and red parts, at a quarter of its resolution as the real one does."""

    def __init__(self, *, labels=LABELS) -> None:
        super().__init__()
        self.config = SimpleNamespace(id2label=labels)
        self.unused = torch.nn.Parameter(torch.zeros(1))

    def forward(self, pixel_values):
        small = torch.nn.functional.avg_pool2d(pixel_values, 4)
        bright = 20 * (small[:, 1] - 1.0)
        red = 20 * (small[:, 0] - small[:, 1] - 1.0)
        masks = torch.stack([bright, red, bright, -1e3 * torch.ones_like(red)], dim=1)
        classes = torch.tensor([[[9.0, 0, 0, 0], [0, 9.0, 0, 0], [0, 0, 9.0, 0], [9.0, 0, 0, 0]]])
        return SimpleNamespace(class_queries_logits=classes, masks_queries_logits=masks)


def scene(height: int, width: int) -> np.ndarray:
    color = np.full((height, width, 3), 40, np.uint8)
    color[height // 4 : height // 2, width // 8 : width // 2] = 255
    color[height // 2 :, width // 2 :] = (255, 20, 20)
    return color


@pytest.mark.parametrize("shape", [(96, 128), (375, 1242), (61, 83), (200, 100)])
def test_masks_lie_where_the_object_is(shape):
    """Through scaling, padding, a quarter of the resolution, and back."""
    segments = Segmenter(Network(), SegmentConfig(shortest=224, longest=400)).segment(scene(*shape))
    found = {each.category: each.mask for each in segments}
    assert set(found) == {"chair", "table"}
    truth = {"chair": scene(*shape)[..., 1] > 200, "table": scene(*shape)[..., 0].astype(int) - 40 > 200}
    truth["table"] &= ~truth["chair"]
    for category, mask in found.items():
        both = (mask & truth[category]).sum() / (mask | truth[category]).sum()
        assert both > 0.88, (category, both)


def test_classes_that_are_none_of_ours_are_refused():
    with pytest.raises(SegmentationError, match=r"classes \(zebra"):
        Segmenter(Network(labels={0: "zebra"}))
    with pytest.raises(SegmentationError, match="8-bit RGB"):
        Segmenter(Network()).segment(np.zeros((10, 10), np.uint8))


def square(left: int, top: int, side: int, category: str = "car") -> Segment:
    mask = np.zeros((100, 200), bool)
    mask[top : top + side, left : left + side] = True
    return Segment(category, 0.9, mask)


def test_detections_take_the_masks_that_fill_their_boxes():
    segments = [square(10, 10, 30), square(60, 10, 30), square(120, 10, 30, "chair")]
    boxes = {
        4: ("car", np.array([58.0, 8.0, 92.0, 44.0])),
        2: ("car", np.array([8.0, 8.0, 42.0, 44.0])),
        3: ("car", np.array([118.0, 8.0, 152.0, 44.0])),  # a chair is no car
        5: ("car", np.array([0.0, 60.0, 20.0, 80.0])),
    }
    ids = detection_masks(segments, boxes, (100, 200))
    assert set(np.unique(ids)) == {0, 2, 4}
    assert (ids[segments[0].mask] == 2).all()
    assert (ids[segments[1].mask] == 4).all()
    assert np.array_equal(np.unique(instance_masks(segments, (100, 200))), [0, 1, 2, 3])


class Views(FrameSource):
    """Two blocks before a wall, from cameras that move sideways; ids change from frame to frame."""

    camera = Intrinsics(100.0, 100.0, 79.5, 59.5, 160, 120)

    def __init__(self, orders: list[tuple[int, int]]) -> None:
        self.orders = orders

    def __len__(self) -> int:
        return len(self.orders)

    def __getitem__(self, index: int) -> Frame:
        T = np.eye(4)
        T[0, 3] = 0.1 * index
        u, v = np.meshgrid(np.arange(160), np.arange(120))
        directions = self.camera.backproject(u, v)
        x = directions[..., 0] * 2.0 + T[0, 3]
        depth, ids = np.full((120, 160), 3.0), np.zeros((120, 160), int)
        for number, low in zip(self.orders[index], (-0.9, 0.2), strict=True):
            on = (x > low) & (x < low + 0.7) & (np.abs(directions[..., 1]) < 0.3)
            depth[on], ids[on] = 2.0, number
        return Frame(str(index), depth, self.camera, T, ids)


@given(st.lists(st.booleans(), min_size=2, max_size=5))
def test_one_object_has_one_id_in_all_frames(swapped):
    frames = Views([(2, 1) if swap else (1, 2) for swap in swapped])
    names = [{1: "chair", 2: "chair"} for _ in swapped]
    linked = link(frames, names)
    assert linked.categories == {1: "chair", 2: "chair"}
    left = {linked.ids[i, order[0]] for i, order in enumerate(frames.orders)}
    right = {linked.ids[i, order[1]] for i, order in enumerate(frames.orders)}
    assert len(left) == len(right) == 1
    assert left != right
    again = linked.relabelled(1, frames[1].instances)
    assert set(np.unique(again)) == {0, 1, 2}


def test_categories_are_kept_apart_and_what_is_seen_once_is_dropped():
    frames = Views([(1, 2), (1, 2), (1, 2)])
    linked = link(frames, [{1: "chair", 2: "table"}, {1: "chair", 2: "table"}, {1: "chair", 2: "chair"}])
    assert linked.categories == {1: "chair", 2: "table"}
    assert (2, 2) not in linked.ids
    assert not linked.relabelled(2, frames[2].instances)[:, 100:].any()
    assert len(link(frames, [{1: "chair", 2: "table"}] * 3, LinkConfig(frames=9)).categories) == 2


def by_color(self, color):
    """In the place of the network: bright is a chair."""
    mask = color.min(axis=2) > 150
    return [Segment("chair", 0.9, mask)] if mask.any() else []


@pytest.fixture
def segmenting(monkeypatch):
    monkeypatch.setattr(Segmenter, "load", classmethod(lambda cls, weights, device: Segmenter(Network())))
    monkeypatch.setattr(Segmenter, "segment", by_color)


def write_folder(root, frames: int = 3):
    views = Views([(1, 2)] * frames)
    (root / "intrinsics.json").write_text('{"fx": 100, "fy": 100, "cx": 79.5, "cy": 59.5}')
    lines = []
    for i in range(frames):
        frame = views[i]
        color = np.where((frame.instances == 1)[..., None], 255, np.full((120, 160, 3), 30)).astype(np.uint8)
        for kind, image in (("depth", (1000 * frame.depth).astype(np.uint16)), ("color", color)):
            (root / kind).mkdir(exist_ok=True)
            cv2.imwrite(str(root / kind / f"{i:03d}.png"), image)
        lines.append(f"{i:03d} {0.1 * i} 0 0 0 0 0 1\n")
    (root / "poses.txt").write_text("".join(lines))


def test_a_folder_without_masks_becomes_a_scan(tmp_path, segmenting, capsys):
    write_folder(tmp_path)
    assert main(["segment", "--root", str(tmp_path)]) == 1
    assert "say which way is up" in capsys.readouterr().err
    assert main(["segment", "--root", str(tmp_path), "--up", "0", "-1", "0"]) == 0
    scan = load_scan("folder", tmp_path)
    assert [each.category for each in scan.instances] == ["chair"]
    assert len(scan.frames) == 3
    assert all(set(np.unique(scan.frames[i].instances)) == {0, 1} for i in range(3))
    assert json.loads((tmp_path / "instances.json").read_text())["up_world"] == [0, -1, 0]
    assert main(["segment", "--root", str(tmp_path)]) == 1
    assert "already there" in capsys.readouterr().err


def wide(root):
    cv2.imwrite(str(root / "color" / "001.png"), np.zeros((90, 160, 3), np.uint8))


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda root: (root / "intrinsics.json").unlink(), "no intrinsics.json"),
        (lambda root: (root / "intrinsics.txt").write_text("1 1 1 1"), "keep one"),
        (lambda root: (root / "intrinsics.json").write_text('{"fx": 9, "fy": 9, "cx": 9, "cy": 9}'), "far from the middle"),
        (lambda root: (root / "poses.txt").unlink(), "no poses.txt"),
        (lambda root: (root / "poses.txt").write_text("000 nan 0 0 0 0 0 1"), "poses.txt, line 1: the pose holds NaN"),
        (wide, "001.png: the colour image is 160x90 pixels and the depth image 160x120"),
        (lambda root: (root / "instances.json").write_text('{"instances": {"1": "chair"}}'), "would be replaced"),
        (lambda root: (root / "instances.json").write_text('{"up_world": [0, 0]}'), "instances.json: up_world must be"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_told_before_an_image_is_segmented(tmp_path, monkeypatch, capsys, damage, message):
    monkeypatch.setattr(Segmenter, "load", classmethod(lambda *_, **__: pytest.fail("too late")))
    write_folder(tmp_path)
    damage(tmp_path)
    up = [] if message.startswith("instances") else ["--up", "0", "-1", "0"]
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    assert main(["segment", "--root", str(tmp_path), *up]) == 1
    assert message in capsys.readouterr().err
    assert {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()} == before


def test_up_is_that_of_a_file_which_says_nothing_else(tmp_path, segmenting):
    write_folder(tmp_path)
    (tmp_path / "instances.json").write_text('{"up_world": [0, -2, 0]}')
    lines = (tmp_path / "poses.txt").read_text().splitlines(keepends=True)
    (tmp_path / "poses.txt").write_text("".join(lines[:2]))
    assert main(["segment", "--root", str(tmp_path)]) == 0
    written = json.loads((tmp_path / "instances.json").read_text())
    assert (written["up_world"], written["instances"]) == ([0, -1, 0], {"1": "chair"})
    # a frame without a pose has no mask
    assert sorted(path.stem for path in (tmp_path / "masks").iterdir()) == ["000", "001"]
    # nor is its own file in the way, as after a kill before the masks had their name
    shutil.rmtree(tmp_path / "masks")
    assert main(["segment", "--root", str(tmp_path)]) == 0


def test_nothing_is_left_where_nothing_is_found(tmp_path, segmenting, capsys, monkeypatch):
    write_folder(tmp_path)
    monkeypatch.setattr(Segmenter, "segment", lambda self, color: [])
    assert main(["segment", "--root", str(tmp_path), "--up", "0", "-1", "0"]) == 1
    assert "no chair, table or car was found" in capsys.readouterr().err
    assert not (tmp_path / "masks").exists()
    assert not (tmp_path / "instances.json").exists()


def test_kitti_gets_a_mask_for_every_detection(tmp_path, segmenting, monkeypatch):
    root = ensure_street(tmp_path, StreetConfig(frames=1, cars=2))

    def cars(self, color):
        frame = load_frame(root)
        assert frame.picture is not None
        boxes = [line.split()[4:8] for line in (root / "detections" / "000000.txt").read_text().splitlines()]
        segments = []
        for left, top, right, bottom in np.array(boxes, float):
            mask = np.zeros(color.shape[:2], bool)
            mask[int(top) : int(bottom), int(left) : int(right)] = True
            segments.append(Segment("car", 0.9, mask))
        return segments[::-1]

    monkeypatch.setattr(Segmenter, "segment", cars)
    assert main(["segment", "--dataset", "kitti", "--root", str(root)]) == 0
    frame = load_frame(root)
    assert frame.picture is not None
    assert frame.picture.instances is not None
    for detection in frame.detections:
        own = frame.picture.ids_at(frame.p_world[detection.box.contains(frame.p_world)])
        assert np.mean(own == detection.id) > 0.8


def test_a_frame_without_a_picture_stops_no_other(tmp_path, segmenting, caplog):
    root = ensure_street(tmp_path, StreetConfig(frames=2, cars=1))
    (root / "training" / "image_2" / "000001.png").unlink()
    assert main(["segment", "--dataset", "kitti", "--root", str(root)]) == 0
    assert [path.name for path in (root / "masks").iterdir()] == ["000000.png"]
    assert "000001.png: no such picture, frame 000001 is left out" in caplog.text


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda root: (root / "detections" / "000001.txt").unlink(), "000001.txt: cannot be read"),
        (lambda root: (root / "training" / "image_2" / "000001.png").write_bytes(b"no png"), "no readable image"),
        (lambda root: [path.unlink() for path in (root / "training" / "image_2").iterdir()], "nothing to segment"),
    ],
)  # fmt: skip
def test_what_is_wrong_with_kitti_is_told_before_a_picture_is_segmented(
    tmp_path, monkeypatch, capsys, damage, message
):
    monkeypatch.setattr(Segmenter, "load", classmethod(lambda *_, **__: pytest.fail("too late")))
    root = ensure_street(tmp_path, StreetConfig(frames=2, cars=1))
    damage(root)
    assert main(["segment", "--dataset", "kitti", "--root", str(root)]) == 1
    assert message in capsys.readouterr().err
    assert not (root / "masks").exists()
