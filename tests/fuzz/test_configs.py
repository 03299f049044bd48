"""`config.json` of a mapping run, and the options of a comparison's faults."""

import json
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from objgraph.cli.run_config import CONFIG, MapRun, Source, read_run
from objgraph.datasets.files import read_json
from objgraph.maps.lidar import LidarMappingConfig
from objgraph.maps.pipeline import MappingConfig
from objgraph.synthetic.faults import faults_from
from tests.fuzz.inputs import attempt, fuzzed, replaced
from tests.fuzz.strategies import damaged


@pytest.fixture(scope="module", params=["folder", "kitti"])
def config(request, tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("run")
    settings = MappingConfig() if request.param == "folder" else LidarMappingConfig()
    MapRun(Source(request.param, Path("DATA"), categories=("chair",)), settings).save(folder)
    read_run(folder / CONFIG, {}, {})
    return folder / CONFIG


@fuzzed
@given(data=st.data())
def test_a_run_with_damaged_settings(config, data):
    with replaced(config.parent, config, data.draw(damaged(config))):
        attempt(read_run, config, {}, {})


@fuzzed
@given(data=st.data())
def test_faults_of_other_values(tmp_path_factory, data):
    path = tmp_path_factory.getbasetemp() / "faults.json"
    path.write_text(json.dumps({"pose_m": [0.0, 0.01], "mask_shift": [0.1, 0.2]}))
    with replaced(path.parent / "none", path, data.draw(damaged(path))):
        attempt(lambda: faults_from(read_json(path), "everyday"))
