"""Where pages, tables and pictures say that an object is."""

import numpy as np

from objgraph.show.placement import place_of
from tests.objgraph.maps.map_cases import failed, mapped


def test_the_calibrated_box_is_shown_where_there_is_one():
    entry = mapped()
    place = place_of(entry)
    assert place is not None
    assert place.is_calibrated
    np.testing.assert_array_equal(place.centre, entry.box_centre)
    np.testing.assert_array_equal(place.covariance, entry.box_covariance)
    raw = mapped(box_centre=None, box_extents=None, box_covariance=None)
    place = place_of(raw)
    assert place is not None
    assert not place.is_calibrated
    assert raw.T_world_object is not None
    np.testing.assert_array_equal(place.centre, raw.T_world_object[:3, 3])
    np.testing.assert_array_equal(place.covariance, raw.covariance)


def test_what_is_not_mapped_has_no_place():
    assert place_of(failed()) is None
