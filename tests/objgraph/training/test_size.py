"""How large objects of a category are, of the meshes at hand."""

import numpy as np
import pytest

from objgraph.training.size import LEAST_SIGMA, USUAL, size_statistics


def test_size_statistics() -> None:
    mean, sigma, _ = size_statistics("chair", [])
    assert (mean, sigma) == pytest.approx(USUAL["chair"])
    mean, sigma, _ = size_statistics(
        "lamp", [(1.0, 0.0, 0.0), (0.5, 0.0, 0.0), (2.0, 0.0, 0.0), (90.0, 0.0, 0.0)]
    )
    assert mean == pytest.approx(1.0)
    assert sigma == pytest.approx(np.log(2) * np.sqrt(2 / 3))
    # many of one source count as ten
    many, few = [(2.0, 0.0, 0.0)] * 500, [(1.0, 0.0, 0.0)] * 10
    mean, sigma, _ = size_statistics("lamp", many + few, ["generator"] * 500 + ["shop"] * 10)
    assert (mean, sigma) == pytest.approx((np.sqrt(2), np.log(2) / 2))
    assert size_statistics("lamp", [])[1] >= 0.5
    assert size_statistics("Couch", []) == size_statistics("sofa", [])
    # meshes of one and the same size do not make the next lamp's known
    assert size_statistics("lamp", [(0.3, 0.3, 1.5)] * 4)[1] == LEAST_SIGMA
    # a model car of half a metre says nothing about cars
    assert size_statistics("car", [(0.2, 0.2, 0.4)])[:2] == pytest.approx(USUAL["car"])


@pytest.mark.parametrize("count", [1, 2])
def test_few_metric_meshes_say_about_how_large_objects_are(count: int) -> None:
    """Of a mug of 16 cm the next one is no metre large, as of a category of which nothing is known."""
    mean, sigma, words = size_statistics("mug", [(0.08, 0.11, 0.08)] * count)
    assert mean == pytest.approx(np.linalg.norm([0.08, 0.11, 0.08]))
    assert sigma == size_statistics("mug", [])[1]
    assert f"{count} metric" in words


def test_sizes_that_are_no_metres_are_told(caplog: pytest.LogCaptureFixture) -> None:
    """Chairs in millimetres were left aside without a word."""
    millimetres = [(450.0, 850.0, 500.0)] * 2
    assert size_statistics("chair", [*millimetres, (0.45, 0.85, 0.5)]) == size_statistics(
        "chair", [(0.45, 0.85, 0.5)]
    )
    (record,) = caplog.records
    assert "chair: 2 of 3 meshes have sizes beyond 0.4 to 4 m" in record.getMessage()
