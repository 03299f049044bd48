"""Whose covariance the ellipses from above show."""

import numpy as np

from objgraph.show.street_picture import _known
from tests.objgraph.maps.map_cases import mapped


def test_ellipses_are_of_the_calibrated_box_where_there_is_one():
    entry = mapped()
    assert entry.box_covariance is not None
    np.testing.assert_array_equal(_known(entry), entry.box_covariance[3:6, 3:6])
    raw = mapped(box_centre=None, box_extents=None, box_covariance=None)
    assert raw.covariance is not None
    np.testing.assert_allclose(_known(raw), raw.covariance[3:6, 3:6])
