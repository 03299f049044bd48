"""An object as it is asked what a view of it would tell: the surface that it has in its map."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from objgraph.active.target import target
from objgraph.covariance.labelled import ObjectCovariance
from objgraph.errors import SolveError
from tests.toys import ToyDecoder, toy_prior, toy_state

COVARIANCE = ObjectCovariance.diagonal(np.full(13, 1e-4), "marginals")


class ThinLegged(ToyDecoder):
    """A table, 0.5 high, whose legs are 0.014 wide: more than a cell of a map's grid, less than one of a grid half as fine."""

    def _network(self, points, injected):
        mirrored = torch.stack([points[:, 0].abs(), points[:, 1], points[:, 2].abs()], dim=1)
        distances = []
        for centre, half in (
            ((0.0, 0.23, 0.0), (0.3, 0.02, 0.2)),
            ((0.26, -0.02, 0.16), (0.007, 0.23, 0.007)),
        ):
            q = (mirrored - torch.tensor(centre).to(points)).abs() - torch.tensor(half).to(points)
            distances.append((q.clamp_min(0).square().sum(dim=1) + 1e-10).sqrt() + q.amax(dim=1).clamp_max(0))
        return torch.stack(distances).amin(dim=0) + 0 * injected["0"][:, 0]


class Nowhere(ToyDecoder):
    """No surface at all."""

    def _network(self, points, injected):
        return 1.0 + 0 * injected["0"][:, 0] * points[:, 0]


def test_a_table_stands_on_its_legs():
    """What falls through the grid is no part of the surface, and cameras look past the object."""
    state = replace(toy_state(), log_scale=np.zeros(3))
    table = target("table 1", replace(toy_prior(), decoder=ThinLegged()), state, COVARIANCE)
    assert np.ptp(state.to_object(table.vertices)[:, 1]) == pytest.approx(0.5, abs=0.01)
    assert table.centre[2] == pytest.approx(state.T_world_object.translation()[2], abs=0.01)
    assert (state.to_object(table.points)[:, 1] < 0.1).any()


def test_an_object_without_a_surface_is_named():
    with pytest.raises(SolveError, match=r"^chair 7: "):
        target("chair 7", replace(toy_prior(), decoder=Nowhere()), toy_state(), COVARIANCE)
