"""Frames, views and their settings, with arguments that are wrong."""

from dataclasses import replace
from typing import Any

from hypothesis import given
from hypothesis import strategies as st

import objgraph
from factors.depth import DepthFactor
from factors.rays import Rays
from objgraph.observation import summarize
from objgraph.observation.frames import ListedFrames
from objgraph.observation.sampling import SensorNoise
from tests.fuzz.api_cases import (
    FRAME,
    FRAME_PARTS,
    KEYS,
    PRIOR,
    QUICK,
    SAMPLING,
    VIEWS,
    evaluated,
)
from tests.fuzz.arguments import arguments, settings_of
from tests.fuzz.inputs import attempt, fuzzed
from tests.objgraph.graph.graph_cases import UP
from tests.toys import INTRINSICS


def use_frame(instance=1, config=SAMPLING, seed=0, **parts: Any) -> None:
    frame = objgraph.Frame(**parts)
    scan = objgraph.Scan("room", ListedFrames([frame]), (objgraph.Instance(1, "chair"),), UP)
    summarize(scan.frames)
    objgraph.maps.scene_floor(scan)
    objgraph.observe(frame, instance, config, seed)


@fuzzed
@given(data=st.data())
def test_frames(data):
    attempt(use_frame, **data.draw(arguments(FRAME_PARTS)))


@fuzzed
@given(data=st.data())
def test_intrinsics(data):
    def use(**parts: Any) -> None:
        changed: dict[str, Any] = FRAME_PARTS | {"intrinsics": objgraph.Intrinsics(**parts)}
        use_frame(**changed)

    attempt(use, **data.draw(arguments(vars(INTRINSICS))))


@fuzzed
@given(data=st.data())
def test_observing(data):
    good = {"frame": FRAME, "instance": 1, "config": SAMPLING, "seed": 0}
    attempt(objgraph.observe, **data.draw(arguments(good)))


@fuzzed
@given(data=st.data())
def test_settings_of_sampling(data):
    kind, noise = data.draw(settings_of(objgraph.SamplingConfig)), data.draw(settings_of(SensorNoise))

    def use() -> None:
        objgraph.observe(FRAME, 1, objgraph.SamplingConfig(**kind))
        objgraph.observe(FRAME, 1, replace(SAMPLING, noise=SensorNoise(**noise)))

    attempt(use)


@fuzzed
@given(data=st.data())
def test_views(data):
    def use(**parts: Any) -> None:
        view = objgraph.ObjectView(**parts)
        for factor in objgraph.ObjectBuilder().view(PRIOR, KEYS, view, view.T_world_camera):
            evaluated(factor)
        objgraph.place(PRIOR, [view, *VIEWS], objgraph.ObjectBuilder(up_world=UP), QUICK)

    attempt(use, **data.draw(arguments(vars(VIEWS[0]))))


@fuzzed
@given(data=st.data())
def test_rays(data):
    def use(**parts: Any) -> None:
        evaluated(DepthFactor(KEYS, PRIOR.decoder, VIEWS[0].T_world_camera, Rays(**parts)))

    attempt(use, **data.draw(arguments(vars(VIEWS[0].rays))))
