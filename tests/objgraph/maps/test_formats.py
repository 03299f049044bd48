"""Maps live on: what an earlier program wrote is read for good, what a later one wrote is refused by name."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from objgraph.errors import MapError
from objgraph.maps.object_map import VERSION, ObjectMap

SAVED = Path(__file__).parent
"""`format_N` are maps as the program wrote them when N was its format: they stay as they are."""


@pytest.mark.parametrize("folder", sorted(SAVED.glob("format_*")), ids=lambda path: path.name)
def test_maps_of_earlier_programs_are_read(folder):
    first, second, lost = ObjectMap.load(folder).objects
    assert (first.id, first.category, first.status) == (1, "chair", "mapped")
    assert first.T_world_object is not None
    np.testing.assert_allclose(
        first.T_world_object[:3, 3], [-0.535669373161111, 0.36159505490948474, 1.3040000451301372]
    )
    assert first.joint_covariance is not None
    assert first.joint_covariance.shape == (17, 17)
    assert first.vertices is not None
    np.testing.assert_allclose(np.ptp(first.vertices, axis=0), [0.5, 0.9, 0.4], atol=1e-6)
    assert first.other is not None
    assert (second.vertices, second.other) == (None, None)
    assert (lost.status, lost.reason) == ("failed", "seen in 12 pixels")
    if folder.name == "format_6":  # verdicts are of later ones
        assert first.trust is None
    else:
        assert first.trust is not None
        assert (first.trust.word, first.trust.why) == ("likely", ("little of its surface is seen",))
    assert second.trust is None


def test_there_is_a_map_of_the_present_format():
    assert (SAVED / f"format_{VERSION}").is_dir()


@pytest.mark.parametrize("version", [VERSION + 1, 10**15])
def test_a_newer_format_is_refused_by_name(version, tmp_path):
    folder = Path(shutil.copytree(SAVED / f"format_{VERSION}", tmp_path / "map"))
    document = json.loads((folder / "map.json").read_text())
    (folder / "map.json").write_text(json.dumps(document | {"version": version}))
    with pytest.raises(
        MapError, match=rf"map\.json: of format {version}, newer than {VERSION}.*update objgraph"
    ):
        ObjectMap.load(folder)
