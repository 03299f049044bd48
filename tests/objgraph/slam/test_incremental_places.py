"""Looking up what is near, against going through all."""

from types import SimpleNamespace
from typing import Any, cast

import gtsam
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from objgraph.slam import IncrementalConfig
from objgraph.slam.association import AssociationConfig
from objgraph.slam.incremental.places import ObjectPlaces, Places

POINT = st.tuples(*[st.floats(-30, 30)] * 3).map(np.array)


@given(st.lists(POINT, max_size=25), st.lists(POINT, min_size=1, max_size=3), st.floats(0.1, 12), st.data())
def test_what_is_near_is_what_a_search_through_all_finds(points, asked, distance, data):
    places, now = Places[int](), {}
    for i, point in enumerate(points):
        places.put(f"p{i:02d}", i, point)
        now[i] = point
    for i in data.draw(st.sets(st.sampled_from(range(len(points))))) if points else ():
        if i % 2:
            now[i] = now[i] + 3.7
            places.put(f"p{i:02d}", i, now[i])
        else:
            places.remove(f"p{i:02d}")
            del now[i]
    expected = [i for i, point in now.items() if min(np.linalg.norm(point - p) for p in asked) < distance]
    assert places.near(np.array(asked), distance) == sorted(expected)
    assert all((f"p{i:02d}" in places) == (i in now) for i in range(len(points)))


@pytest.mark.parametrize("reach", [1.0, 6.0])
def test_what_is_within_reach_is_looked_at(reach):
    """By the setting: a camera may have drifted by that much."""
    config = IncrementalConfig(association=AssociationConfig(reach=reach))
    far = gtsam.Pose3(gtsam.Rot3(), np.array([5.0, 0.0, 0.0]))
    places = ObjectPlaces(cast(Any, SimpleNamespace(config=config, pose=lambda _: far)))
    entry: Any = SimpleNamespace(name="chair 0", keys=SimpleNamespace(pose=0))
    places.note([entry])
    view: Any = SimpleNamespace(points_world=np.zeros((3, 3)))
    assert places.of([view]) == ([entry] if reach > 5 else [])
