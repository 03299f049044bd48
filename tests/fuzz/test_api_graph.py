"""Objects in a graph, with arguments that are wrong."""

from dataclasses import replace
from typing import Any

import gtsam
import numpy as np
from gtsam.symbol_shorthand import X
from hypothesis import given
from hypothesis import strategies as st

import objgraph
from factors.base import Annealing
from objgraph.graph.initialise import InitialisationConfig
from objgraph.graph.solve import LevenbergMarquardtConfig, minimize
from tests.fuzz.api_cases import (
    BRIEF,
    KEYS,
    POSE,
    PRIOR,
    QUICK,
    STATE,
    VIEWS,
)
from tests.fuzz.arguments import arguments, settings_of, wrong
from tests.fuzz.inputs import attempt, fuzzed
from tests.objgraph.graph.graph_cases import UP


def own_graph(**given: Any) -> objgraph.ObjectGraph:
    good = {"graph": gtsam.NonlinearFactorGraph(), "values": gtsam.Values(), "initialisation": QUICK}
    return objgraph.ObjectGraph(**(good | {"up_world": UP, "floor": 0.0} | given))


@fuzzed
@given(data=st.data())
def test_object_graphs(data):
    good = {"up_world": UP, "floor": 0.0, "config": objgraph.GraphConfig(), "initialisation": QUICK}
    given = data.draw(arguments(good, {"graph": gtsam.NonlinearFactorGraph(), "values": gtsam.Values()}))

    def use() -> None:
        objects = own_graph(**given)
        handle = objects.add_object(PRIOR, STATE)
        objects.stand_on_floor(handle)

    attempt(use)


@fuzzed
@given(data=st.data())
def test_objects_that_are_added(data):
    good = {
        "prior": PRIOR, "start": STATE, "keys": KEYS, "name": "chair", "box": box(),
    }  # fmt: skip
    views = data.draw(st.lists(st.sampled_from(VIEWS), max_size=2))
    given = data.draw(arguments(good | {"start": data.draw(st.sampled_from([STATE, VIEWS, views]))}))

    def use() -> None:
        objects = own_graph()
        try:
            objects.observe(objects.add_object(**given), VIEWS[0])
        except objgraph.ObjectGraphError:
            assert (objects.graph.nrFactors(), objects.values.size(), len(objects.objects)) == (0, 0, 0)
            raise

    attempt(use)


def box(**changes: Any) -> objgraph.DetectedBox:
    good = {
        "T_world_object": STATE.T_world_object, "size": np.ones(3), "position_sigma": 0.1,
        "heading_sigma": 0.1, "size_sigma": 0.1,
    }  # fmt: skip
    return objgraph.DetectedBox(**(good | changes))


@fuzzed
@given(data=st.data())
def test_boxes(data):
    given = data.draw(arguments(vars(box())))
    attempt(lambda: own_graph().add_object(PRIOR, STATE, box=box(**given)))


@fuzzed
@given(data=st.data())
def test_what_is_asked_of_a_graph(data):
    objects = own_graph()
    handle = objects.add_object(PRIOR, STATE)
    gone = objects.add_object(PRIOR, replace(STATE, code=np.ones(4)))
    objects.remove_object(gone)
    objects.observe(handle, VIEWS[0])
    good = {"handle": handle, "view": VIEWS[0], "camera": POSE}
    given = data.draw(arguments(good, {"body_T_camera": POSE}))
    handles = data.draw(st.one_of(st.just(gone), wrong(handle)))
    others = data.draw(st.one_of(wrong([1]), st.lists(st.sampled_from([*KEYS, X(0), -1, 2**70]), max_size=3)))
    size = objects.graph.size()
    if attempt(objects.observe, **given):
        assert objects.graph.size() == size
    attempt(objects.joint_marginals, handle, others)
    for ask in (objects.marginals, objects.state, objects.stand_on_floor, objects.remove_object):
        attempt(ask, handles)
    attempt(objects.remove_view, handles, VIEWS[0])
    attempt(objects.remove_view, handle, data.draw(wrong(VIEWS[0])))
    attempt(objects.refresh, data.draw(wrong(Annealing())))
    attempt(objects.optimize, data.draw(wrong(BRIEF)))


@fuzzed
@given(data=st.data())
def test_settings_of_graphs(data):
    given = data.draw(settings_of(objgraph.GraphConfig))

    def use() -> None:
        builder = objgraph.ObjectBuilder(objgraph.GraphConfig(**given), UP, 0.0)
        single = builder.alone(PRIOR, STATE, VIEWS[:1])
        minimize(single, LevenbergMarquardtConfig(iterations=1))

    attempt(use)


@fuzzed
@given(data=st.data())
def test_settings_of_solving(data):
    solver, inner = (
        data.draw(settings_of(objgraph.SolverConfig)),
        data.draw(settings_of(LevenbergMarquardtConfig)),
    )
    start = data.draw(settings_of(InitialisationConfig))

    def use() -> None:
        thin = [view.thinned(10, 10) for view in VIEWS]
        single = objgraph.ObjectBuilder(up_world=UP).alone(PRIOR, STATE, thin)
        objgraph.solve(
            [single], objgraph.SolverConfig(**({"inner": LevenbergMarquardtConfig(**inner)} | solver))
        )

    def place() -> None:
        config = {**vars(QUICK), **start}
        objgraph.place(PRIOR, VIEWS, objgraph.ObjectBuilder(up_world=UP), InitialisationConfig(**config))

    attempt(use)
    attempt(place)
