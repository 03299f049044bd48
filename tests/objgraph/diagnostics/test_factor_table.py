"""The table of factors by cost, and the graph's picture."""

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import X

from objgraph.diagnostics.factor_table import cost_table, format_table, observation_names, to_dot
from objgraph.errors import FactorError, SolveError
from objgraph.graph.object_graph import ObjectGraph
from objgraph.observation.sampling import SamplingConfig, observe
from tests.toys import toy_frame, toy_prior, toy_state

UP = np.array([0.0, 0.0, 1.0])


@pytest.fixture(scope="module")
def objects() -> ObjectGraph:
    """A chair in one view, a camera that wants to be elsewhere, and an empty slot."""
    state = toy_state()
    view = observe(toy_frame([state], 0.3), 1, SamplingConfig(points=40, hits=20, free=20))
    noise = gtsam.noiseModel.Isotropic.Sigma(6, 0.1)
    objects = ObjectGraph(gtsam.NonlinearFactorGraph(), gtsam.Values(), up_world=UP)
    T = view.T_world_camera
    objects.values.insert(X(0), T)
    objects.values.insert(42, T)
    objects.graph.push_back(gtsam.PriorFactorPose3(X(0), T, noise))
    objects.graph.push_back(gtsam.PriorFactorPose3(X(0), T, noise))
    objects.graph.push_back(gtsam.BetweenFactorPose3(X(0), 42, T.Expmap(np.full(6, 3.0)), noise))
    objects.graph.remove(1)
    objects.observe(objects.add_object(toy_prior(), state, name='the "red" chair'), view, X(0))
    objects.refresh()
    return objects


@pytest.fixture(scope="module")
def names(objects) -> dict[int, str]:
    (handle,) = objects.objects
    return observation_names(handle.name, handle.slots, handle.factors)


def test_all_factors_by_cost(objects, names):
    rows = cost_table(objects.graph, objects.values, names)
    assert len(rows) == objects.graph.nrFactors()
    assert {row.index for row in rows} == set(range(objects.graph.size())) - {1}
    assert [row.cost for row in rows] == sorted((row.cost for row in rows), reverse=True)
    assert sum(row.cost for row in rows) == pytest.approx(objects.graph.error(objects.values))
    assert sum(row.share for row in rows) == pytest.approx(1)
    assert (rows[0].kind, rows[0].keys) == ("BetweenFactorPose3", ("x0", "42"))
    for row in rows:
        assert row.cost == objects.graph.at(row.index).error(objects.values)


def test_decoder_factors_have_names(objects, names):
    (handle,) = objects.objects
    rows = {row.kind: row for row in cost_table(objects.graph, objects.values, names)}
    for factor in handle.factors:
        row = rows[f'{type(factor).__name__} of the "red" chair']
        assert row.cost == pytest.approx(factor.loss(objects.values))
        assert row.keys == ("o0", "s0", "z0", "x0")
    assert rows['upright_prior of the "red" chair'].keys == ("o0",)
    kinds = {row.kind for row in cost_table(objects.graph, objects.values)}
    assert kinds == {
        "CustomFactor", "BetweenFactorPose3", "PriorFactorPose3", "PriorFactorVector", "MagPoseFactorPose3",
    }  # fmt: skip


def test_the_table_in_text(objects, names):
    rows = cost_table(objects.graph, objects.values, names)
    lines = format_table(rows).split("\n")
    assert len(lines) == 1 + len(rows)
    assert lines[0].split() == ["factor", "kind", "keys", "cost", "share"]
    assert lines[1].split()[:4] == ["2", "BetweenFactorPose3", "x0", "42"]
    assert len({len(line) for line in lines}) == 1
    short = format_table(rows, most=2).split("\n")
    assert short[-1].startswith(f"and {len(rows) - 2} more of ")
    assert format_table(()).startswith("factor")


def test_a_cost_that_is_no_number_comes_first():
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    values.insert(X(0), gtsam.Pose3())
    noise = gtsam.noiseModel.Isotropic.Sigma(6, 0.1)
    for x in (1.0, np.nan):
        graph.push_back(gtsam.PriorFactorPose3(X(0), gtsam.Pose3(gtsam.Rot3(), np.array([x, 0, 0])), noise))
    bad, good = cost_table(graph, values)
    assert np.isnan(bad.cost)
    assert (bad.index, good.index, good.share) == (1, 0, 1.0)


def test_what_cannot_be_evaluated_is_named(objects):
    graph, values = objects.graph, gtsam.Values(objects.values)
    values.update(objects.objects[0].keys.code, np.full(4, np.nan))
    with pytest.raises(FactorError, match=r"Factor\(o0, s0, z0, x0\).* not finite"):
        cost_table(graph, values)
    values.erase(42)
    with pytest.raises(SolveError, match="factors on 42"):
        cost_table(graph, values)


def test_the_picture(objects, names):
    (handle,) = objects.objects
    text = to_dot(objects.graph, objects.values, names, {handle.name: handle.keys})
    assert text.startswith("graph {")
    assert text.count("{") == text.count("}") == 2
    assert 'label="the \\"red\\" chair";' in text
    for key in ("o0", "s0", "z0", "x0", "42"):
        assert text.count(f'  "{key}";') == 1
    for row in cost_table(objects.graph, objects.values, names):
        for key in row.keys:
            assert f'factor{row.index} -- "{key}";' in text
    assert text.count(" -- ") == sum(
        len(objects.graph.at(i).keys()) for i in (0, 2, *range(3, objects.graph.size()))
    )
    assert 'label="BetweenFactorPose3\\n' in text
    assert 'label="SurfaceFactor of the \\"red\\" chair\\n' in text
