"""What the loaders of users' own data warn of, masks of no frame among it, and frames that have cameras of their own."""

import logging
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from objgraph.doctor import Finding, examine_scan
from objgraph.doctor.images import examine_camera
from objgraph.doctor.seen import look
from objgraph.observation.frames import Intrinsics, ListedFrames
from tests.objgraph.datasets.bag_files import write_recording
from tests.objgraph.datasets.dataset_folders import (
    frames_of,
    png,
    toy_scan,
    write_bytes,
    write_nerfstudio,
    write_plain_folder,
    write_tum_sequence,
)
from tests.objgraph.doctor.doctor_cases import edit

WRITERS: dict[str, Callable[..., Path]] = {
    "bag": write_recording,
    "folder": write_plain_folder,
    "nerfstudio": write_nerfstudio,
    "tum": write_tum_sequence,
}


def found(dataset: str, folder: Path, where: str) -> list[Finding]:
    sections = examine_scan(dataset, folder).sections
    return [each for section in sections for each in section.findings if each.where == where]


@pytest.mark.parametrize("end", ["png", "json"])
@pytest.mark.parametrize("dataset", WRITERS)
def test_ids_without_a_name_and_masks_without_a_frame(dataset, end, tmp_path):
    WRITERS[dataset](tmp_path, toy_scan())
    assert not found(dataset, tmp_path, "masks")
    edit(tmp_path / "instances.json", lambda c: c["instances"].pop("3"))
    (tmp_path / "masks" / f"lost.{end}").write_text("[]")
    unused, unnamed = found(dataset, tmp_path, "masks")
    assert "1 masks have no depth image of their name: lost; the frames are called " in unused.what
    assert not unused.note
    assert "the masks have ids that are not named: 3 (in 3 frames)" in unnamed.what


def test_masks_of_images_without_depth_are_nobodys_fault(tmp_path):
    tum = write_tum_sequence(tmp_path / "tum", toy_scan(), mask="rgb")
    (tum / "depth.txt").write_text("\n".join((tum / "depth.txt").read_text().splitlines()[:-1]))
    assert not found("tum", tum, "masks")
    nerfstudio = write_nerfstudio(tmp_path / "nerfstudio", toy_scan())
    edit(nerfstudio / "transforms.json", lambda c: c["frames"][1].pop("depth_file_path"))
    assert not found("nerfstudio", nerfstudio, "masks")


def test_warnings_that_nobody_wants_to_see_are_found(tmp_path):
    folder = write_plain_folder(tmp_path, toy_scan())
    (folder / "masks" / "lost.png").write_bytes(b"")
    program = logging.getLogger("objgraph")
    level = program.level
    program.setLevel(logging.ERROR)
    try:
        (unused,) = found("folder", folder, "masks")
    finally:
        program.setLevel(level)
    assert "1 masks have no depth image of their name: lost" in unused.what


def test_what_to_do_is_that_of_the_warning(tmp_path):
    folder = write_plain_folder(tmp_path, toy_scan())
    (folder / "masks" / "000001.png").unlink()
    with (folder / "poses.txt").open("a") as file:
        file.write("000000 0 0 0 0 0 0 1\n")
    write_bytes(folder / "color" / "000000.png", png(np.zeros((90, 160, 3), np.uint8)))
    left_out, repeated, color = found("folder", folder, "frames")
    assert "1 of 3 frames have no mask and are left out" in left_out.what
    assert "else write what is missing" in left_out.do
    assert "begins several lines" in repeated.what
    assert "the colour image is 160x90 pixels" in color.what
    assert repeated.do == color.do == ""
    assert all(each.note for each in (left_out, repeated, color))


def test_cameras_of_single_frames_are_told_together():
    def camera(k: int, frame):
        K = Intrinsics(60 + k, (60 + k) * (1.3 if k else 1), 31.5, 23.5 + k, 64, 48)
        return replace(frame, intrinsics=K)

    scan = toy_scan()
    frames = [camera(k, frame) for k, frame in enumerate(frames_of(scan))]
    section = examine_camera(look(replace(scan, frames=ListedFrames(frames))))
    assert section.rows == (
        ("images", "3 of 64x48 pixels"),
        ("intrinsics", "fx 60.0 to 62.0, fy 60.0 to 80.6, cx 31.5, cy 23.5 to 25.5"),
        ("field of view", "55 to 56 x 33 to 44 degrees"),
        ("principal point", "+0.0% of the width, +0.0% to +4.2% of the height from the middle"),
    )
    (finding,) = section.findings
    assert finding.what == (
        "fx 61.0 to 62.0 and fy 79.3 to 80.6 differ: the matrix is for images of other proportions (in 2 of 3 frames)"
    )
