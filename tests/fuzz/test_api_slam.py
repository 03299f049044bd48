"""Maps that grow, with arguments that are wrong."""

from typing import Any

import gtsam
from gtsam.symbol_shorthand import X
from hypothesis import given
from hypothesis import strategies as st

import objgraph
from objgraph.slam.association import AssociationConfig
from objgraph.slam.incremental.config import Tolerance
from objgraph.slam.odometry import OdometryNoise
from tests.fuzz.api_cases import BRIEF, FRAME, POSE, PRIOR, QUICK, SAMPLING
from tests.fuzz.arguments import arguments, settings_of, wrong
from tests.fuzz.inputs import attempt, fuzzed
from tests.objgraph.graph.graph_cases import UP


def mapper(**given: Any) -> objgraph.IncrementalObjectGraph:
    config = objgraph.IncrementalConfig(
        sampling=SAMPLING, initialisation=QUICK, start=BRIEF, tracking=BRIEF, rough=BRIEF
    )
    return objgraph.IncrementalObjectGraph(
        **({"up_world": UP, "config": config, "find_prior": lambda _: PRIOR} | given)
    )


def detections() -> list[objgraph.Instance]:
    return [objgraph.Instance(1, "chair")]


@fuzzed
@given(data=st.data())
def test_incremental_maps(data):
    good = {"up_world": UP}
    optional = {"floor": 0.0, "config": None, "find_prior": None, "body_T_camera": POSE, "object_keys": None}
    given = data.draw(arguments(good, optional))

    def use() -> None:
        mapper(**given).update(FRAME, detections())

    attempt(use)


@fuzzed
@given(data=st.data())
def test_updates(data):
    factors = [gtsam.PriorFactorPose3(X(0), POSE, gtsam.noiseModel.Isotropic.Sigma(6, 0.1))]
    good = {"frame": FRAME, "detections": detections(), "camera": X(0)}
    given = data.draw(arguments(good, {"factors": factors, "values": gtsam.Values()}))
    objects = mapper()
    if attempt(objects.update, **given):
        assert not objects.cameras
        objects.update(FRAME, detections())


@fuzzed
@given(data=st.data())
def test_steps_of_a_callers_own_smoother(data):
    isam = gtsam.ISAM2()
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    graph.push_back(gtsam.PriorFactorPose3(X(0), POSE, gtsam.noiseModel.Isotropic.Sigma(6, 0.1)))
    values.insert(X(0), POSE)
    isam.update(graph, values)
    good = {"frame": FRAME, "detections": detections(), "camera": X(0)}
    config = objgraph.IncrementalConfig(
        sampling=SAMPLING, initialisation=QUICK, start=BRIEF, tracking=BRIEF, rough=BRIEF
    )

    def use(**made: Any) -> objgraph.ObjectFrontEnd:
        return objgraph.ObjectFrontEnd(
            **({"smoother": isam, "up_world": UP, "config": config, "find_prior": lambda _: PRIOR} | made)
        )

    attempt(
        use, **data.draw(arguments({"smoother": isam, "up_world": UP}, {"floor": 0.0, "body_T_camera": POSE}))
    )
    front_end = use()
    attempt(front_end.step, **data.draw(arguments(good)))
    attempt(front_end.accept, data.draw(wrong([1])))


@fuzzed
@given(data=st.data())
def test_settings_of_incremental_maps(data):
    kind = data.draw(
        st.sampled_from([objgraph.IncrementalConfig, AssociationConfig, OdometryNoise, Tolerance])
    )
    given = data.draw(settings_of(kind))
    name = {AssociationConfig: "association", OdometryNoise: "odometry", Tolerance: "tolerance"}.get(kind)
    config = {
        "sampling": SAMPLING,
        "initialisation": QUICK,
        "start": BRIEF,
        "tracking": BRIEF,
        "rough": BRIEF,
    }

    def use() -> None:
        changed = given if name is None else {name: kind(**given)}
        objects = mapper(config=objgraph.IncrementalConfig(**(config | changed)))
        objects.update(FRAME, detections())
        objects.update(FRAME, detections())

    attempt(use)
