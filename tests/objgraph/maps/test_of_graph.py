"""Maps of objects that stand in a graph of the caller's."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import gtsam
import numpy as np
import pytest

from objgraph.covariance.box import box_pose
from objgraph.covariance.heading_modes import HeadingModes
from objgraph.covariance.surface import surface_sigma
from objgraph.errors import CovarianceError, MapError, ObservationError, SolveError
from objgraph.graph.object_graph import ObjectGraph
from objgraph.maps import of_graph
from objgraph.maps.object_map import ObjectMap
from objgraph.maps.of_graph import map_of
from objgraph.priors.mesh import extract_mesh
from objgraph.trust.judge import judge
from tests.objgraph.trust.calibrations import calibration
from tests.objgraph.trust.test_judge import KNOWN, PRIOR, SHIFT, UP, solved
from tests.toys import toy_state

CELLS = 32


@pytest.fixture(scope="module")
def graph():
    return solved()


def given(array: np.ndarray | None) -> np.ndarray:
    assert array is not None
    return array


def test_a_graphs_object_is_mapped_as_it_stands_there(graph, tmp_path):
    objects, chair = graph
    found = map_of(objects, "kitchen", KNOWN, CELLS)
    assert (found.scene, len(found.objects)) == ("kitchen", 1)
    np.testing.assert_array_equal(found.up_world, UP)
    (entry,) = found.objects
    state, covariance, said = objects.state(chair), objects.marginals(chair), judge(objects, chair, KNOWN)
    assert (entry.id, entry.name, entry.status, entry.estimator) == (0, "chair 0", "mapped", "graph")
    assert said is not None
    assert entry.trust is not None
    assert entry.trust.evidence == pytest.approx(said.trust.evidence, abs=0.02)  # of a coarser mesh
    np.testing.assert_allclose(entry.uncertainty.matrix, covariance.matrix, rtol=1e-9)
    mesh = np.asarray(extract_mesh(PRIOR.decoder, state.code, CELLS).vertices)
    np.testing.assert_allclose(given(entry.vertices), state.to_world(mesh))
    extents = box_pose(PRIOR, state, covariance, mesh).extents
    np.testing.assert_allclose(given(entry.box_extents), extents)
    sigma = surface_sigma(PRIOR.decoder, state, covariance.times(PRIOR.surface_misfit), mesh)
    np.testing.assert_allclose(given(entry.vertex_sigma), sigma)
    cameras = [view.T_world_camera.matrix() for view in objects.views(chair)]
    np.testing.assert_allclose(given(entry.cameras), cameras)
    assert entry.cost_final is None  # none was of this object alone
    assert entry.linearizations is None
    found.save(tmp_path / "map")
    again = ObjectMap.load(tmp_path / "map")
    np.testing.assert_allclose(given(again.objects[0].box_covariance), given(entry.box_covariance))


@pytest.mark.parametrize("known", [KNOWN, calibration("other weights")])
def test_other_headings_go_along_with_an_object_that_its_cameras_have_moved(known):
    """As a loop closure moves them: they were found where the object was placed, and stay about it."""
    objects, chair = solved(shift=SHIFT)
    placed = toy_state(1.0)
    quarter = gtsam.Pose3(gtsam.Rot3.Ry(np.pi / 2), np.array([0.02, 0.0, -0.01]))
    turned = replace(placed, T_world_object=placed.T_world_object.compose(quarter))
    chair.other_headings = HeadingModes(np.array([0.7, 0.3, 0.0, 0.0]), (placed, turned, None, None))
    (entry,) = map_of(objects, calibration=known, resolution=CELLS).objects
    headings = entry.other_headings
    assert headings is not None
    assert headings.states[1] is not None
    between = objects.state(chair).T_world_object.between(headings.states[1].T_world_object)
    assert between.equals(quarter, 1e-6)
    if known is KNOWN:
        own, other = (mode.box.T_world_box for mode in entry.box_modes)
        assert np.linalg.norm(own.between(other).translation()) < 0.1  # 3.4 m where it was left behind


def test_what_cannot_be_mapped_is_said_and_costs_no_other(graph):
    objects, chair = graph
    lost = SimpleNamespace(name="chair 7", prior=PRIOR, keys=chair.keys, other_headings=None)

    class Both:
        builder, objects = graph[0].builder, [lost, chair]

        def state(self, handle: Any):
            return objects.state(chair)

        def marginals(self, handle: Any):
            if handle is lost:
                raise SolveError("chair 7 is not determined")
            return objects.marginals(handle)

        def views(self, handle: Any):
            return objects.views(chair)

    failed, mapped = map_of(cast(Any, Both()), calibration=KNOWN, resolution=CELLS).objects
    assert (failed.status, failed.reason) == ("failed", "chair 7 is not determined")
    assert mapped.status == "mapped"


def test_an_object_without_views_has_a_mesh_and_no_verdict():
    objects = ObjectGraph(gtsam.NonlinearFactorGraph(), gtsam.Values(), up_world=UP)
    objects.add_object(PRIOR, toy_state(1.0))
    pose = objects.objects[0].keys.pose
    objects.graph.push_back(
        gtsam.PriorFactorPose3(pose, objects.values.atPose3(pose), gtsam.noiseModel.Isotropic.Sigma(6, 0.1))
    )
    (entry,) = map_of(objects, calibration=KNOWN, resolution=CELLS).objects
    assert entry.status == "mapped", entry.reason
    assert entry.vertices is not None
    assert (entry.trust, entry.box_covariance, entry.views) == (None, None, ())


def test_what_no_calibration_knows_is_mapped_without_asking_how_it_may_stand(graph, monkeypatch):
    monkeypatch.setattr(of_graph, "estimate_in", lambda *_: pytest.fail("nobody judges it"))
    (entry,) = map_of(graph[0], calibration=calibration("other weights"), resolution=CELLS).objects
    assert (entry.status, entry.trust, entry.box_covariance) == ("mapped", None, None)
    assert len(entry.views) == len(graph[0].views(graph[1]))


@pytest.mark.parametrize(
    ("names", "numbers"),
    [
        (["chair 4", "chair 2"], [4, 2]),
        (["office chair 4", "bar stool 2"], [4, 2]),
        (["chair 4", "the chair"], [0, 1]),
        (["chair 4", "chair 4"], [0, 1]),
        (["chair 4", "office chair 4"], [0, 1]),
        (["chair 4", "chair b2"], [0, 1]),
    ],
)
def test_ids_are_the_numbers_of_names_that_have_their_own(names, numbers):
    objects = ObjectGraph(gtsam.NonlinearFactorGraph(), gtsam.Values(), up_world=UP)
    for name in names:
        objects.add_object(PRIOR, toy_state(1.0), name=name)
    found = map_of(objects, calibration=KNOWN, resolution=CELLS)  # undetermined: none has a view
    assert [entry.id for entry in found.objects] == numbers
    assert {entry.status for entry in found.objects} == {"failed"}


def test_bad_input_is_named(graph):
    lost = ObjectGraph(gtsam.NonlinearFactorGraph(), gtsam.Values())
    with pytest.raises(ObservationError, match="which way is up"):
        map_of(lost)
    with pytest.raises(MapError, match="scene"):
        map_of(graph[0], cast(Any, 3))
    with pytest.raises(CovarianceError, match="calibration"):
        map_of(graph[0], calibration=cast(Any, "mine"))
