"""`config.json` is every setting, and makes the same run again; what is wrong with one is named."""

import json
from dataclasses import asdict, replace
from pathlib import Path

import pytest

from objgraph.cli.run_config import MapRun, Source, read_run
from objgraph.errors import ConfigError, DatasetError
from objgraph.estimate.graph import GraphEstimator
from objgraph.estimate.heading_modes import HeadingModesConfig
from objgraph.graph.builder import GraphConfig
from objgraph.graph.solve import SolverConfig
from objgraph.maps import pipeline
from objgraph.maps.lidar import LidarMappingConfig
from objgraph.maps.lidar_task import ROADS, DetectorNoise, LidarTaskConfig
from objgraph.maps.pipeline import MappingConfig
from objgraph.version import program_version

ROOM = Source("scannet", Path("DATA/scannet"), "scene1", ("chair",), None, Path("cads"))
CAMERA = MappingConfig(
    views=2,
    priors=("sofa.safetensors",),
    graph=GraphConfig(renderer="sampled", sides=None, pose_sigma=(0.01, 0.02)),
    solver=SolverConfig(slopes=(50.0, 90.0), rounds=2),
    heading_modes=HeadingModesConfig(temperature=3.0),
    estimator="both",
)
STREET = LidarMappingConfig(
    seed=3, task=LidarTaskConfig(detector=DetectorNoise(0.2)), graph=replace(ROADS, floor_sigma=0.1)
)


@pytest.mark.parametrize(
    "run",
    [
        MapRun(ROOM, CAMERA),
        MapRun(ROOM, replace(CAMERA, heading_modes=None)),
        MapRun(Source("sample"), MappingConfig()),
        MapRun(Source("kitti", Path("K"), "000008"), STREET),
        MapRun(Source("street"), LidarMappingConfig()),
    ],
)
def test_a_saved_run_comes_back_as_it_was(tmp_path, run):
    run.save(tmp_path)
    assert read_run(tmp_path / "config.json", {}, {}) == run
    document = json.loads((tmp_path / "config.json").read_text())
    assert document["objgraph"] == program_version()
    assert document["dataset"] == run.source.dataset
    assert document["settings"].keys() == asdict(run.settings).keys()
    if run.settings.heading_modes is not None:
        assert document["settings"]["heading_modes"]["temperature"] == run.settings.heading_modes.temperature


def test_what_is_typed_wins_over_the_file_and_the_rest_is_kept(tmp_path):
    MapRun(ROOM, CAMERA).save(tmp_path)
    typed = {"scene": "scene2", "root": Path("elsewhere")}
    found = read_run(tmp_path / "config.json", typed, {"--views": (("views",), 1)})
    assert found == MapRun(replace(ROOM, scene="scene2", root=Path("elsewhere")), replace(CAMERA, views=1))


def test_a_setting_given_in_part_keeps_the_rest_of_its_own_default(tmp_path):
    path = write(tmp_path, {"graph": {"floor_sigma": 1}, "heading_modes": {"solver": {"rounds": 1}}})
    settings = read_run(path, {"dataset": "kitti"}, {}).settings
    assert settings.graph == replace(ROADS, floor_sigma=1.0)
    assert isinstance(settings.graph.floor_sigma, float)
    assert settings.heading_modes is not None
    assert settings.heading_modes.solver == replace(HeadingModesConfig().solver, rounds=1)


def write(folder: Path, settings: object) -> Path:
    path = folder / "own.json"
    path.write_text(json.dumps({"settings": settings}))
    return path


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        (
            {"solver": {"ronds": 3}},
            r"settings\.solver: no setting ronds of data set 'sample'; there are .*rounds",
        ),
        ({"task": {}}, "settings: no setting task of data set 'sample'"),
        ({"solver": {"rounds": "three"}}, r'settings: solver\.rounds must be int, not "three"'),
        ({"solver": {"rounds": 2.5}}, r"settings: solver\.rounds must be int, not 2\.5"),
        ({"views": True}, "settings: views must be int, not true"),
        ({"graph": {"renderer": "fast"}}, r'settings: graph\.renderer must be Literal.*, not "fast"'),
        ({"graph": {"sides": "x"}}, r'settings: graph\.sides must be .*float.*, not "x"'),
        ({"solver": {"slopes": [60, "x"]}}, r"settings: solver\.slopes"),
        ({"graph": {"pose_sigma": [0.01]}}, r"pose_sigma must be"),
        ({"graph": {"pose_sigma": [0.01, "x"]}}, r"pose_sigma"),
        ({"graph": {"pose_sigma": [0.01, 0]}}, r"pose_sigma\[1\] must be"),
        ({"solver": 3}, r"settings: solver must be SolverConfig, not 3"),
        ({"priors": "sofa.safetensors"}, "settings: priors must be tuple"),
        (3, "settings: an object of settings was expected, not 3"),
        ({"graph": {"sides": float("nan")}}, "not a readable JSON file"),
    ],
)
def test_what_is_wrong_is_named_with_its_file_and_field(tmp_path, settings, message):
    path = write(tmp_path, settings)
    with pytest.raises(ConfigError, match=message) as caught:
        read_run(path, {"dataset": "sample"}, {})
    assert str(caught.value).startswith(str(path))


@pytest.mark.parametrize("group", [None, 3, "x", [1]])
def test_a_group_that_is_none_is_named_where_an_option_goes_into_it(tmp_path, group):
    path = write(tmp_path, {"sampling": group})
    message = r"settings\.sampling: an object of settings was expected, not"
    with pytest.raises(ConfigError, match=message) as caught:
        read_run(path, {"dataset": "sample"}, {"--min-pixels": (("sampling.min_pixels",), 50)})
    assert str(caught.value).startswith(str(path))


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("{", "not a readable JSON file"),
        ("[]", "holds a list"),
        ('{"dataset": 3}', "dataset must be str, not 3"),
        ('{"dataset": "sample", "speed": 3}', "no setting speed; there are dataset, root"),
    ],
)
def test_a_file_of_something_else_is_refused(tmp_path, content, message):
    path = tmp_path / "own.json"
    path.write_text(content)
    with pytest.raises(ConfigError, match=message):
        read_run(path, {}, {})
    with pytest.raises(ConfigError, match=r"absent\.json: not a readable JSON file"):
        read_run(tmp_path / "absent.json", {}, {})


def test_a_run_has_a_data_set_and_only_settings_that_it_uses():
    with pytest.raises(DatasetError, match="--dataset must name one"):
        read_run(None, {}, {})
    with pytest.raises(DatasetError, match="data set 'street' does not use --views; its settings are seed"):
        read_run(None, {"dataset": "street"}, {"--views": (("views",), 3)})


@pytest.mark.parametrize(
    ("source", "settings"),
    [
        ({"root": Path("Stra\udcdfe")}, {}),
        ({"categories": ("Stra\udcdfe",)}, {}),
        ({"topic": {"depth": "Stra\udcdfe"}}, {}),
        ({}, {"--priors": (("priors",), ("Stra\udcdfe",))}),
    ],
)
def test_a_name_that_no_file_could_hold_is_refused(source, settings):
    with pytest.raises(ConfigError, match=r"'Stra\\udcdfe' is no Unicode text; rename it"):
        read_run(None, {"dataset": "folder", **source}, settings)


def test_the_search_for_headings_is_the_settings_own():
    chosen, _ = pipeline._estimators(CAMERA)
    assert isinstance(chosen, GraphEstimator)
    assert chosen.heading_modes == CAMERA.heading_modes
