"""The page of a map: what it holds against the map itself, its pictures against the renderer, and a click in a browser."""

import base64
import json
import re
import shutil
import subprocess
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.stats import chi2

from objgraph.cli.main import main
from objgraph.errors import MapError
from objgraph.maps.mapped_object import MappedObject
from objgraph.maps.object_map import ObjectMap
from objgraph.observation.frames import Frame, ListedFrames
from objgraph.show import raster
from objgraph.show.placement import LEAST, LEVEL
from objgraph.show.report import REPORT, object_pictures, write_report
from objgraph.show.summary import position_covariance
from tests.browser import open_page
from tests.objgraph.maps.map_cases import UP, failed, mapped
from tests.toys import toy_frame, toy_mesh, toy_state


def contents(path: Path) -> dict:
    """What the page's script reads."""
    (data,) = re.findall(
        r'<script type="application/json" id="data">(.*?)</script>', path.read_text(), re.DOTALL
    )
    return json.loads(data)


def matrix(values: list[float]) -> np.ndarray:
    return np.array(values).reshape(4, 4).T


def transformed(T: np.ndarray, p: np.ndarray) -> np.ndarray:
    return p @ T[:3, :3].T + T[:3, 3]


@pytest.fixture
def saved(tmp_path) -> tuple[ObjectMap, Path]:
    object_map = ObjectMap("a room", (mapped(1, 1), mapped(2, 2), failed(9)), UP)
    object_map.save(tmp_path)
    return object_map, tmp_path


def test_the_page_holds_the_map(saved):
    object_map, folder = saved
    points = np.random.default_rng(0).normal(size=(500, 3))
    points[3] = np.nan
    page = contents(write_report(folder, points, np.full((500, 3), 0.5)))
    assert page["title"] == "a room"
    assert page["mapped"] == 2
    assert page["up"] == UP.tolist()
    np.testing.assert_allclose(
        np.frombuffer(base64.b64decode(page["points"]["positions"]), "<f4").reshape(-1, 3),
        np.delete(points, 3, axis=0), rtol=1e-6,
    )  # fmt: skip
    assert set(base64.b64decode(page["points"]["colors"])) == {128}
    for entry, shown in zip(object_map.objects, page["objects"], strict=True):
        assert shown["id"] == entry.id
        assert set(shown["row"]) <= {column["key"] for column in page["columns"]} | set(shown["row"])
        if entry.status == "failed":
            assert shown["remarks"] == [entry.reason]
            assert shown["mesh"] is shown["ellipsoid"] is shown["box"] is None
            continue
        (glb,) = folder.glob(f"object_{entry.id}_*.glb")
        assert base64.b64decode(shown["mesh"]) == glb.read_bytes()


def test_ellipsoids_boxes_and_modes_are_the_map_s(saved):
    object_map, folder = saved
    page = contents(write_report(folder))
    sphere = np.random.default_rng(0).normal(size=(200, 3))
    sphere /= np.linalg.norm(sphere, axis=1, keepdims=True)
    cube = np.stack(np.meshgrid(*3 * [[-0.5, 0.5]], indexing="ij"), -1).reshape(-1, 3)
    drawn = 0
    for entry, shown in zip(object_map.mapped, page["objects"], strict=False):
        assert entry.T_world_object is not None
        assert entry.box_covariance is not None
        assert entry.box_centre is not None
        assert entry.box_extents is not None
        off = transformed(matrix(shown["ellipsoid"]), sphere) - entry.box_centre
        covariance = position_covariance(entry.T_world_object, entry.box_covariance)
        squared = np.einsum("ni,ij,nj->n", off, np.linalg.inv(covariance), off)
        np.testing.assert_allclose(squared, chi2.ppf(LEVEL, 3), rtol=1e-6)
        corners = (transformed(matrix(shown["box"]), cube) - entry.box_centre) @ entry.T_world_object[:3, :3]
        np.testing.assert_allclose(np.abs(corners), np.tile(entry.box_extents / 2, (8, 1)), rtol=1e-9)
        modes = entry.other_headings
        assert modes is not None
        kept = [
            (p, state) for p, state in zip(modes.probability[1:], modes.states[1:], strict=True) if p > LEAST
        ]
        for (p, state), mode in zip(kept, shown["modes"], strict=True):
            assert state is not None
            p_object = np.random.default_rng(1).normal(size=(20, 3))
            moved = transformed(matrix(mode["matrix"]), entry.state.to_world(p_object))
            np.testing.assert_allclose(moved, state.to_world(p_object), atol=1e-9)
            assert mode["probability"] == pytest.approx(p)
            drawn += 1
    assert drawn > 2


def test_without_calibration_the_estimator_s_covariance_is_shown_and_said_to_be_small(tmp_path):
    entry = mapped(1, box_centre=None, box_extents=None, box_covariance=None, turns=None, turned=None)
    ObjectMap("x", (entry,), UP).save(tmp_path)
    (shown,) = contents(write_report(tmp_path))["objects"]
    assert entry.T_world_object is not None
    np.testing.assert_allclose(matrix(shown["ellipsoid"])[:3, 3], entry.T_world_object[:3, 3])
    assert "not calibrated" in " ".join(shown["remarks"])
    assert entry.vertices is not None
    corner = np.abs(transformed(np.linalg.inv(matrix(shown["box"])), entry.vertices)).max(axis=0)
    np.testing.assert_allclose(corner, 0.5, rtol=1e-3)


def test_errors_beside_the_map_are_columns(saved):
    _, folder = saved
    before = [column["key"] for column in contents(write_report(folder))["columns"]]
    assert "box_iou" not in before
    (folder / "evaluation.json").write_text(
        json.dumps({"objects": [{"id": 2, "box_iou": 0.5, "chamfer_m": 0.03}]})
    )
    page = contents(write_report(folder))
    assert "box_iou" in [column["key"] for column in page["columns"]]
    rows = {shown["id"]: shown["row"] for shown in page["objects"]}
    assert rows[2]["box_iou"] == 0.5
    assert rows[2]["chamfer_m"] == pytest.approx(3)
    assert rows[1]["box_iou"] is None
    (folder / "evaluation.json").write_text("[")
    with pytest.raises(MapError, match=r"evaluation\.json: not a readable"):
        write_report(folder)


def test_what_no_page_can_hold_is_named(saved):
    _, folder = saved
    with pytest.raises(MapError, match="5 points need as many RGB colours"):
        write_report(folder, np.zeros((5, 3)), np.zeros((3, 3)))
    (folder / "evaluation.json").write_text('{"objects": [{"id": 1, "translation_m": 1e307}]}')
    with pytest.raises(MapError, match=rf"{folder}: a number of the map or of evaluation\.json is too large"):
        write_report(folder)
    assert not (folder / REPORT).exists()


def test_a_reason_does_not_name_its_object_twice(tmp_path):
    ObjectMap("x", (failed(9, "table 9: no surface"),), UP).save(tmp_path)
    (shown,) = contents(write_report(tmp_path))["objects"]
    assert shown["remarks"] == ["no surface"]


@pytest.mark.parametrize(
    "entry", [3, {"id": "1"}, {"id": 1, "translation_m": []}, {"id": 1, "box_iou": "0.5"}]
)
def test_errors_that_are_no_numbers_are_named(saved, entry):
    (saved[1] / "evaluation.json").write_text(json.dumps({"objects": [entry]}))
    with pytest.raises(MapError, match=r"evaluation\.json: not a readable list of errors"):
        write_report(saved[1])


def test_names_cannot_end_the_script_and_nothing_is_fetched(tmp_path):
    name = "</script><script>alert(1)</script>{{data}}"
    ObjectMap(name, (failed(reason=name),), UP).save(tmp_path)
    path = write_report(tmp_path)
    assert contents(path)["title"] == name
    text = path.read_text()
    assert name not in text
    assert "default-src 'none'" in text
    assert not re.search(r"""(?:src|href)=["']?https?:""", text)


def seen_twice() -> tuple[list[Frame], Callable[..., MappedObject]]:
    """Two frames of a chair, and what makes its entry of a map."""
    state = toy_state()
    mesh = toy_mesh(state.code)
    frames = [toy_frame([state], azimuth, f"f{i}") for i, azimuth in enumerate((0.5, 1.5))]
    vertices, faces = state.to_world(np.asarray(mesh.vertices)), np.asarray(mesh.faces)
    return frames, partial(mapped, 1, vertices=vertices, faces=faces, vertex_sigma=None)


def test_views_are_cut_out_with_both_outlines():
    frames, entry_of = seen_twice()
    entry = entry_of(views=("f1", "gone"), cameras=np.stack([frames[1].T_world_camera] * 2))
    ((shown,),) = object_pictures([entry], ListedFrames(frames)).values()
    assert shown.frame == "f1"
    assert shown.rgb.shape[1] == 360
    red = np.all(np.abs(shown.rgb.astype(int) - (213, 94, 0)) < 40, axis=2)
    # the outline of what the renderer draws, in the same cut
    assert entry.vertices is not None
    assert entry.faces is not None
    surface = raster.Surface(entry.vertices, entry.faces, np.ones_like(entry.vertices))
    camera = raster.Camera(frames[1].intrinsics, frames[1].T_world_camera)
    drawn = np.isfinite(raster.draw_surfaces(camera, [surface]).depth)
    rows, columns = (np.flatnonzero(drawn.any(axis=axis)) for axis in (1, 0))
    edge = np.ptp(columns) + 1
    found = np.flatnonzero(red.any(axis=0))
    height = np.flatnonzero(red.any(axis=1))
    assert np.ptp(height) / np.ptp(found) == pytest.approx((np.ptp(rows) + 1) / edge, rel=0.05)
    color = np.full((*frames[1].depth.shape, 3), 200, np.uint8)
    colored = replace(frames[1], color=color)
    ((again,),) = object_pictures([entry], ListedFrames([colored])).values()
    assert (np.all(np.abs(again.rgb.astype(int) - 200) < 3, axis=2)).mean() > 0.5
    # a colour image of twice the size sees the same
    larger = replace(colored, color=cv2.resize(color, None, fx=2, fy=2))
    ((twice,),) = object_pictures([entry], ListedFrames([larger])).values()
    same = cv2.resize(twice.rgb, again.rgb.shape[1::-1])
    assert np.abs(same.astype(int) - again.rgb).mean() < 6


def test_of_frames_with_one_name_the_one_that_was_looked_from_is_shown():
    frames, entry_of = seen_twice()
    entry = entry_of(views=("f0", "f1"), cameras=np.stack([frame.T_world_camera for frame in frames]))
    (named,) = object_pictures([entry], ListedFrames(frames)).values()
    alike = [replace(frame, name="f") for frame in frames]
    (found,) = object_pictures([replace(entry, views=("f", "f"))], ListedFrames(alike)).values()
    for shown, expected in zip(found, named, strict=True):
        np.testing.assert_array_equal(shown.rgb, expected.rgb)


def test_the_command_needs_a_map_and_tells_what_the_page_lacks(saved, tmp_path, capsys):
    _, folder = saved
    assert main(["report", str(folder)]) == 0
    assert "MB" in capsys.readouterr().out
    assert contents(folder / REPORT)["points"] is None
    assert main(["report", str(tmp_path / "nowhere")]) == 1
    assert "there is no map here" in capsys.readouterr().err


@pytest.mark.skipif(shutil.which("node") is None, reason="no node to run the page's script")
@pytest.mark.parametrize("side", [2.0, 200.0, 1000.0, 50_000.0])
def test_a_page_opens_on_the_whole_map_however_large_it_is(side, tmp_path):
    """A camera that sees half a kilometre far showed nothing of a street's map."""
    entries = []
    for i in range(9):
        entry, place = mapped(i, i), side / 2 * np.array([i % 3, i // 3, 0.0])
        assert entry.T_world_object is not None
        T = entry.T_world_object.copy()
        T[:3, 3] = place
        entries.append(replace(entry, T_world_object=T, box_centre=place))
    ObjectMap("a street", tuple(entries), UP).save(tmp_path)
    script = Path(__file__).with_name("opened_page.js")
    said = subprocess.run(
        ["node", script, write_report(tmp_path)], capture_output=True, text=True, check=True
    ).stdout
    assert json.loads(said.splitlines()[-1]) == [9, 9]


def test_a_click_on_an_object_shows_its_row(saved):
    object_map, folder = saved
    write_report(folder, np.random.default_rng(0).normal(size=(100, 3)))
    with open_page(folder / REPORT) as page:
        page.wait_for_function("scenes !== null && scenes.where(2) !== null")
        x, y = page.evaluate("scenes.where(2)")
        page.mouse.click(x, y)
        assert page.text_content("#object h2") == "chair 2"
        assert page.evaluate("document.body.dataset.chosen") == "2"
        size = object_map.objects[1].size_m
        assert size is not None
        assert " x ".join(f"{edge:.2f}" for edge in size) in (page.text_content("#object dl") or "")
        assert page.text_content("tbody tr.chosen td") == "chair 2"
        page.click("th button >> nth=0")
        rising = page.locator("tbody tr td:first-child").all_text_contents()
        page.click("th button >> nth=0")
        assert page.locator("tbody tr td:first-child").all_text_contents() == rising[::-1]
        page.click("tbody tr:has-text('table 9')")
        assert "seen in 12 pixels" in (page.text_content("#object") or "")
