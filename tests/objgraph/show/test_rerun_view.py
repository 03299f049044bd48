"""A recording read back: what it holds against the map, the scan, the solver and the growing map."""

import sys
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

pytest.importorskip("rerun", reason="install it with: pip install 'objgraph[view]'")

import rerun as rr
from rerun.chunk import RrdReader

from objgraph.cli import view
from objgraph.cli.main import main
from objgraph.cli.run_config import MapRun, Source
from objgraph.errors import ViewError
from objgraph.estimate.graph import GraphEstimator
from objgraph.estimate.task import Estimate
from objgraph.geometry.frames import transformed_back
from objgraph.maps import pipeline
from objgraph.maps.lidar import LidarMappingConfig
from objgraph.maps.object_map import ObjectMap
from objgraph.maps.pipeline import MappingConfig
from objgraph.observation.frames import ListedFrames
from objgraph.show import raster, rerun_view
from objgraph.show.placement import LEAST, LEVEL
from objgraph.show.summary import position_covariance
from tests.objgraph.estimate.adam_cases import task
from tests.objgraph.maps.map_cases import UP, failed, mapped
from tests.objgraph.maps.test_pipeline import CONFIG, chair, toy_priors, toy_scan
from tests.objgraph.slam.test_incremental import mapper, two_chairs
from tests.toys import toy_frame, toy_mesh, toy_state

STATIC = None


class Recorded:
    """A file's components by entity, component and place on a timeline."""

    def __init__(self, path: Path) -> None:
        reader = RrdReader(path)
        assert len(reader.recordings()) == 1
        self.blueprints = len(reader.blueprints())
        self.values: dict[tuple[str, str], dict[int | None, np.ndarray]] = {}
        self.timelines: set[str] = set()
        for chunk in reader.stream():
            rows = chunk.to_record_batch().to_pydict()
            self.timelines |= {*chunk.timeline_names}
            (times,) = [rows[name] for name in chunk.timeline_names] or [[STATIC] * chunk.num_rows]
            for name in rows.keys() - {*chunk.timeline_names}:
                for time, value in zip(times, rows[name], strict=True):
                    if value is not None:
                        key = chunk.entity_path, name.rpartition(":")[2]
                        self.values.setdefault(key, {})[time] = value

    def entities(self) -> set[str]:
        return {path for path, _ in self.values}

    def array(self, path: str, component: str, time: int | None = STATIC) -> np.ndarray:
        return np.array(self.values[path, component][time])

    def text(self, path: str) -> str:
        (text,) = self.values[path, "text"][STATIC]
        return text


def written(recording, folder: Path) -> Recorded:
    return Recorded(rerun_view.save_recording(recording, folder / "out.rrd"))


@pytest.fixture
def saved(tmp_path) -> tuple[ObjectMap, Path]:
    object_map = ObjectMap("a | room", (mapped(1, 1), mapped(2, 2, category="trash bin"), failed(9)), UP)
    object_map.save(tmp_path)
    return object_map, tmp_path


def test_meshes_boxes_ellipsoids_and_other_headings_are_the_map_s(saved, tmp_path):
    object_map, folder = saved
    recording = rerun_view.new_recording("x")
    rerun_view.log_objects(recording, object_map, folder)
    found = written(recording, tmp_path)
    ghosts = 0
    for entry, name in zip(object_map.mapped, ("chair_1", "trash_bin_2"), strict=True):
        path = f"/world/objects/{name}"
        np.testing.assert_allclose(found.array(f"{path}/mesh", "vertex_positions"), entry.vertices, rtol=1e-6)
        np.testing.assert_array_equal(found.array(f"{path}/mesh", "triangle_indices"), entry.faces)
        assert entry.vertices is not None
        assert len(found.array(f"{path}/mesh", "vertex_colors")) == len(entry.vertices)

        assert entry.T_world_object is not None
        assert entry.box_extents is not None
        assert entry.box_covariance is not None
        (half,) = found.array(f"{path}/box", "half_sizes")
        np.testing.assert_allclose(2 * half, entry.box_extents, rtol=1e-6)
        np.testing.assert_allclose(found.array(f"{path}/box", "centers")[0], entry.box_centre, rtol=1e-6)
        rotation = Rotation.from_quat(found.array(f"{path}/box", "quaternions")[0]).as_matrix()
        np.testing.assert_allclose(rotation, entry.T_world_object[:3, :3], atol=1e-6)

        (radii,) = found.array(f"{path}/ellipsoid", "half_sizes")
        axes = Rotation.from_quat(found.array(f"{path}/ellipsoid", "quaternions")[0]).as_matrix()
        covariance = axes @ np.diag(radii**2 / chi2.ppf(LEVEL, 3)) @ axes.T
        expected = position_covariance(entry.T_world_object, entry.box_covariance)
        np.testing.assert_allclose(covariance, expected, atol=1e-5 * np.trace(expected))

        modes = entry.other_headings
        assert modes is not None
        for quarter in (1, 2, 3):
            ghost = f"{path}/other_headings/turned_{90 * quarter}"
            state = modes.states[quarter]
            if modes.probability[quarter] <= LEAST:
                assert ghost not in found.entities()
                continue
            assert state is not None
            p_object = transformed_back(entry.T_world_object, entry.vertices) / entry.scale
            np.testing.assert_allclose(
                found.array(ghost, "vertex_positions"), state.to_world(p_object), atol=1e-5
            )
            ghosts += 1
    assert ghosts > 2
    assert not any("table_9/" in path for path in found.entities())


def test_the_table_and_each_object_s_text_say_what_the_page_says(saved, tmp_path):
    object_map, folder = saved
    recording = rerun_view.new_recording("x")
    rerun_view.log_objects(recording, object_map, folder)
    found = written(recording, tmp_path)
    table = found.text("/table")
    assert r"a \| room" in table  # a name cannot break the table
    for entry in object_map.mapped:
        assert entry.box_extents is not None
        size = " x ".join(f"{edge:.2f}" for edge in entry.box_extents)
        assert entry.trust is not None
        verdict = f"{entry.trust.word}, {entry.trust.percent} %"
        assert f"| {entry.category} {entry.id} | {verdict} | {size} |" in table
    assert "- table 9: seen in 12 pixels" in table
    assert "seen in 12 pixels" in found.text("/world/objects/table_9")
    assert "may stand turned by" in found.text("/world/objects/trash_bin_2")


@pytest.mark.parametrize(
    ("up", "axes"), [((0, 0, 1), [3, 5, 1]), ((0, -0.99, np.sqrt(1 - 0.99**2)), [3, 2, 5])]
)
def test_the_world_s_up_is_the_axis_that_is_nearest_to_the_scan_s(up, axes, tmp_path):
    object_map = ObjectMap("x", (failed(),), np.array(up))
    object_map.save(tmp_path)
    recording = rerun_view.new_recording("x")
    rerun_view.log_objects(recording, object_map, tmp_path)
    assert written(recording, tmp_path).array("/world", "xyz")[0].tolist() == axes


def test_frames_come_with_their_camera_colours_depth_masks_and_outlines(tmp_path):
    state = toy_state()
    mesh = toy_mesh(state.code)
    frames = [toy_frame([state], 0.5 * i, f"f{i}") for i in range(6)]
    color = np.full((480, 640, 3), (200, 100, 50), np.uint8)  # twice the depth's size
    frames = [replace(frame, color=color) for frame in frames]
    entry = mapped(
        1, vertices=state.to_world(np.asarray(mesh.vertices)), faces=np.asarray(mesh.faces), vertex_sigma=None,
        views=("f3", "gone"), cameras=np.stack([frames[3].T_world_camera] * 2),
    )  # fmt: skip
    object_map = ObjectMap("x", (failed(7), entry), UP)
    recording = rerun_view.new_recording("x")
    rerun_view.log_frames(recording, object_map, ListedFrames(frames), 2)
    found = written(recording, tmp_path)
    assert found.timelines == {"frame"}
    assert [*found.values["/world/camera", "translation"]] == [0, 3, 5]  # evenly, and what it was mapped from
    assert len(found.array("/world/trajectory", "strips")[0]) == 3
    for i in (0, 3, 5):
        frame, K = frames[i], frames[i].intrinsics
        np.testing.assert_allclose(
            found.array("/world/camera", "translation", i)[0], frame.T_world_camera[:3, 3], rtol=1e-6
        )
        rotation = found.array("/world/camera", "mat3x3", i)[0].reshape(3, 3).T  # column-major
        np.testing.assert_allclose(rotation, frame.T_world_camera[:3, :3], atol=1e-6)
        matrix = found.array("/world/camera", "image_from_camera", i)[0].reshape(3, 3).T
        np.testing.assert_allclose(matrix, [[K.fx, 0, K.cx + 0.5], [0, K.fy, K.cy + 0.5], [0, 0, 1]])
        depth = _image(found, "/world/camera/depth", i) / 1000
        np.testing.assert_allclose(depth, frame.depth, atol=5.01e-4)
        bgr = _image(found, "/world/camera/color", i)
        assert bgr.shape == (240, 320, 3)
        assert np.abs(bgr[..., ::-1].astype(int) - (200, 100, 50)).max() < 5
        masks = np.frombuffer(
            bytes(found.array("/world/camera/masks", "buffer", i)[0].astype(np.uint8)), np.uint16
        )
        np.testing.assert_array_equal(masks.reshape(240, 320), 2 * (frame.instances == 1))
        outline = np.concatenate([*found.values["/world/camera/outlines", "strips"][i]])
        assert entry.vertices is not None
        assert entry.faces is not None
        surface = raster.Surface(entry.vertices, entry.faces, np.ones_like(entry.vertices))
        drawn = raster.draw_surfaces(raster.Camera(K, frame.T_world_camera), [surface]).depth
        v, u = np.nonzero(np.isfinite(drawn))
        np.testing.assert_allclose(outline.min(axis=0), [u.min() + 0.5, v.min() + 0.5])
        np.testing.assert_allclose(outline.max(axis=0), [u.max() + 0.5, v.max() + 0.5])


def _image(found: Recorded, path: str, time: int) -> np.ndarray:
    image = cv2.imdecode(found.array(path, "blob", time)[0].astype(np.uint8), cv2.IMREAD_UNCHANGED)
    assert image is not None
    return image


def test_points_that_are_not_finite_are_left_out(tmp_path):
    points = np.random.default_rng(0).normal(size=(50, 3))
    points[3] = np.nan
    recording = rerun_view.new_recording("x")
    rerun_view.log_points(recording, points, np.full((50, 3), 0.5))
    found = written(recording, tmp_path)
    np.testing.assert_allclose(
        found.array("/world/points", "positions"), np.delete(points, 3, axis=0), rtol=1e-6
    )
    assert {*found.array("/world/points", "colors")} == {0x808080FF}


def test_the_solver_s_steps_lead_from_the_start_that_was_taken_to_the_estimate(tmp_path):
    one = task()
    far = one.starts[0].retract(np.r_[0, 2.0, 0, np.zeros(10)])
    one = replace(one, starts=(far, one.starts[0]))
    iterates = rerun_view.Iterates()
    (estimate,) = GraphEstimator(heading_modes=None, watch=iterates).estimate([one])
    assert isinstance(estimate, Estimate)
    (unwatched,) = GraphEstimator(heading_modes=None).estimate([one])
    assert isinstance(unwatched, Estimate)
    assert unwatched.cost_final == estimate.cost_final  # to look on changes nothing
    steps = iterates.towards(estimate.state)
    assert steps[0].cost is None
    assert np.linalg.norm(one.starts[1].local_coordinates(steps[0].state)) < 1e-9
    assert min(np.linalg.norm(estimate.state.local_coordinates(step.state)) for step in steps) < 1e-9
    recording = rerun_view.new_recording("x")
    rerun_view.log_iterations(recording, one.prior, steps)
    found = written(recording, tmp_path)
    assert found.timelines == {"iteration"}
    assert [*found.values["/world/iterate/box", "half_sizes"]] == [*range(len(steps))]
    costs = [found.array("/cost", "scalars", i)[0] for i in range(1, len(steps))]
    assert costs == [step.cost for step in steps[1:]]


def test_no_steps_lead_nowhere():
    assert rerun_view.Iterates().towards(toy_state()) == []


def test_a_growing_map_is_on_the_timeline_with_its_covariances(tmp_path):
    world, objects = two_chairs(12), mapper()
    recording = rerun_view.new_recording("x")
    for frame in world.frames[:4]:
        objects.update(frame, world.detections(frame))
        rerun_view.log_incremental(objects, frame, recording)
    found = written(recording, tmp_path)
    assert found.timelines == {"frame"}
    assert found.blueprints == 1
    last = 3
    T_world_camera = objects.pose([*objects.cameras][last]).matrix()
    np.testing.assert_allclose(
        found.array("/world/camera", "translation", last)[0], T_world_camera[:3, 3], rtol=1e-6
    )
    assert len(found.array("/world/trajectory", "strips", last)[0]) == 4
    assert objects.objects
    for entry in objects.objects:
        path = f"/world/objects/{entry.name.replace(' ', '_')}"
        state, covariance = objects.state(entry), objects.marginals(entry).rigid
        radii = found.array(f"{path}/ellipsoid", "half_sizes", last)[0]
        variances = np.linalg.eigvalsh(covariance[3:6, 3:6])
        np.testing.assert_allclose(np.sort(radii), np.sqrt(variances * chi2.ppf(LEVEL, 3)), rtol=1e-4)
        rotation = Rotation.from_quat(found.array(f"{path}/box", "quaternions", last)[0]).as_matrix()
        np.testing.assert_allclose(rotation, state.T_world_object.rotation().matrix(), atol=1e-6)


def test_without_a_screen_the_command_writes_a_file_and_says_how_to_see_it(saved, monkeypatch, capsys):
    _, folder = saved
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(sys, "platform", "linux")
    assert main(["view", str(folder)]) == 0
    printed = capsys.readouterr().out
    assert f"`rerun {folder / 'map.rrd'}` shows it" in printed
    assert "app.rerun.io" in printed
    found = Recorded(folder / "map.rrd")
    assert found.blueprints == 1
    assert "/world/objects/chair_1/mesh" in found.entities()


def test_with_a_screen_the_viewer_is_started(saved, monkeypatch):
    _, folder = saved
    monkeypatch.setenv("DISPLAY", ":0")
    shown = []
    monkeypatch.setattr(rerun_view, "show_recording", shown.append)
    assert main(["view", str(folder)]) == 0
    assert len(shown) == 1
    assert not [*folder.glob("*.rrd")]


def test_a_scan_that_is_gone_leaves_the_map_alone_and_says_so(saved, tmp_path, caplog):
    _, folder = saved
    MapRun(Source("folder", tmp_path / "gone"), MappingConfig()).save(folder)
    assert main(["view", str(folder), "--save", str(tmp_path / "x.rrd")]) == 0
    assert "shown without its scan" in caplog.text
    assert "gone: no such folder" in caplog.text
    entities = Recorded(tmp_path / "x.rrd").entities()
    assert "/world/objects/chair_1/mesh" in entities
    assert not {"/world/points", "/world/camera"} & entities


def test_an_object_is_solved_again_by_the_map_s_own_settings(saved, tmp_path, monkeypatch, capsys):
    _, folder = saved
    MapRun(Source("folder", tmp_path), CONFIG).save(folder)
    scan = toy_scan()
    monkeypatch.setattr(view, "load_scan_of", lambda source: (scan, None))
    for module in (view, pipeline):
        monkeypatch.setattr(module, "prior_for", toy_priors)
    assert main(["view", str(folder), "--solve", "1", "--save", str(tmp_path / "x.rrd")]) == 0
    found = Recorded(tmp_path / "x.rrd")
    assert found.timelines == {"iteration"}
    centres = found.values["/world/iterate/box", "centers"]
    assert len(centres) > 4
    truth = chair(1)
    middle = truth.to_world(toy_mesh(truth.code).bounds).mean(axis=0)
    assert np.linalg.norm(np.array(centres[max(t for t in centres if t is not None)]) - middle) < 0.05
    capsys.readouterr()
    assert main(["view", str(folder), "--solve", "9"]) == 1
    assert "--solve 9: no mapped object has this id; there are [1, 2]" in capsys.readouterr().err


def test_a_missing_package_is_named_with_the_extra_that_has_it(saved, monkeypatch, capsys):
    _, folder = saved
    monkeypatch.setitem(sys.modules, "rerun", None)
    for name in [name for name in sys.modules if name.startswith("objgraph.show.rerun_view")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.delattr("objgraph.show.rerun_view")
    assert main(["view", str(folder)]) == 1
    assert "pip install 'objgraph[view]'" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "problem"),
    [
        (["--save", "x.txt"], "name it x.txt.rrd"),
        (["--save", "map.json/x.rrd"], "map.json/x.rrd: cannot be written"),
        (["--frames", "0"], "at least one"),
        (["--solve", "1"], "config.json: not a readable JSON file"),
    ],
)
def test_what_cannot_be_done_is_one_line(arguments, problem, saved, tmp_path, monkeypatch, capsys):
    _, folder = saved
    monkeypatch.chdir(tmp_path)
    assert main(["view", str(folder), *arguments]) == 1
    assert problem in " ".join(capsys.readouterr().err.split())
    assert not [*tmp_path.glob(".*rrd")]


@pytest.mark.parametrize("name", ["x.txt", "map.json/x.rrd"])
def test_a_file_that_cannot_be_is_told_before_the_work(name, saved, monkeypatch, capsys):
    _, folder = saved
    monkeypatch.setattr(view, "ObjectMap", None)
    assert main(["view", str(folder), "--save", str(folder / name)]) == 1
    assert name in " ".join(capsys.readouterr().err.split())


@pytest.mark.parametrize(
    ("dataset", "settings", "problem"),
    [
        ("sample", MappingConfig(estimator="adam"), "--estimator adam"),
        ("kitti", LidarMappingConfig(), "not from a LiDAR's scan"),
    ],
)
def test_only_the_graph_s_steps_on_depth_images_can_be_shown(dataset, settings, problem, saved, capsys):
    _, folder = saved
    MapRun(Source(dataset), settings).save(folder)
    assert main(["view", str(folder), "--solve", "1"]) == 1
    assert problem in " ".join(capsys.readouterr().err.split())


def test_a_viewer_that_does_not_start_is_one_error(monkeypatch):
    def spawn(self) -> None:
        raise RuntimeError("no rerun here")

    monkeypatch.setattr(rr.RecordingStream, "spawn", spawn)
    with pytest.raises(ViewError, match=r"does not start \(no rerun here\); --save"):
        rerun_view.show_recording(rerun_view.new_recording("x"))
