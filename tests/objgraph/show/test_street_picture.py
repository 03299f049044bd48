"""A street's picture from above, against where the scan says that things are."""

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.patches import Polygon
from matplotlib.text import Annotation
from scipy.spatial.transform import Rotation

from objgraph.maps.object_map import ObjectMap
from objgraph.observation.lidar.frame import Detection, LidarFrame
from objgraph.show.street_picture import _from_above, _reach
from tests.objgraph.maps.map_cases import mapped

AXES = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""World (z up) of a LiDAR (x right, y down, z ahead) that looks along x."""
AHEAD, LEFT = 12.0, 3.0


def street(place: tuple[float, float, float], heading: float) -> tuple[ObjectMap, LidarFrame]:
    """A car twelve metres ahead of the LiDAR and three to its left, wherever that stands."""
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = Rotation.from_rotvec([0, 0, heading]).as_matrix() @ AXES, place
    T_world_car = T.copy()
    T_world_car[:3, 3] = T[:3, :3] @ [-LEFT, 1.0, AHEAD] + T[:3, 3]
    found = Detection(1, "car", T_world_car, np.array([1.8, 1.5, 4.0]))
    frame = LidarFrame("0", np.array([[-LEFT, 1.0, AHEAD]]), T, np.array([0.0, 0.0, 1.0]), (found,))
    car, shift = mapped(1), T_world_car[:3, 3]
    assert car.vertices is not None
    vertices = car.vertices - car.vertices.mean(axis=0) + shift
    unsure = dict.fromkeys(("box_centre", "box_extents", "box_covariance", "trust"))
    entry = mapped(1, T_world_object=T_world_car, vertices=vertices, **unsure)
    return ObjectMap("street", (entry,), np.array([0.0, 0.0, 1.0])), frame


@pytest.mark.parametrize(("place", "heading"), [((0.0, 0.0, 1.7), 0.0), ((250.0, -80.0, 30.0), 2.1)])
def test_from_above_things_are_where_they_are_from_the_lidar(place, heading):
    object_map, frame = street(place, heading)
    axis = Figure().subplots()
    _from_above(axis, object_map, frame)
    outlines = [each for each in axis.patches if isinstance(each, Polygon)]
    np.testing.assert_allclose(np.asarray(axis.lines[0].get_xydata()), [[AHEAD, LEFT]], atol=1e-9)
    for each in outlines:
        corners = np.asarray(each.get_xy())
        np.testing.assert_allclose((corners.min(axis=0) + corners.max(axis=0)) / 2, [AHEAD, LEFT], atol=0.05)
    assert len(outlines) == 3  # what was detected, the estimate's footprint and its box
    (name,) = axis.texts
    assert isinstance(name, Annotation)
    assert tuple(name.xy) == pytest.approx((AHEAD, LEFT))
    low, high = _reach(frame)
    assert (low < (AHEAD, LEFT)).all()
    assert (high > (AHEAD, LEFT)).all()
