"""Whole maps, with arguments that are wrong."""

from collections.abc import Mapping
from typing import Any

from hypothesis import given
from hypothesis import strategies as st

import objgraph
from objgraph.estimate import AdamConfig
from objgraph.estimate.heading_modes import HeadingModesConfig
from objgraph.observation.frames import ListedFrames
from objgraph.observation.view_selection import ViewSelectionConfig
from tests.fuzz.api_cases import (
    BRIEF,
    FRAME,
    QUICK,
    SAMPLING,
    patched,
)
from tests.fuzz.arguments import arguments, settings_of, wrong
from tests.fuzz.inputs import attempt, fuzzed
from tests.objgraph.graph.graph_cases import UP
from tests.objgraph.maps.map_cases import mapped, other


@fuzzed
@given(data=st.data())
def test_mapped_objects(data):
    good = mapped(1, other=other())
    given = data.draw(arguments(vars(good)))

    def use() -> None:
        entry = type(good)(**given)
        _ = entry.other_headings, entry.box_modes
        _ = entry.state
        _ = entry.uncertainty

    attempt(use)
    attempt(lambda: type(good.other)(**data.draw(arguments(vars(good.other)))))


@fuzzed
@given(data=st.data())
def test_object_maps(data, tmp_path_factory):
    good = {"scene": "room", "objects": (mapped(1),), "up_world": UP}
    given = data.draw(arguments(good))
    folder = tmp_path_factory.getbasetemp() / "written"
    attempt(lambda: objgraph.ObjectMap(**given).save(folder))
    attempt(objgraph.ObjectMap.load, data.draw(wrong("folder")))
    if folder.exists():
        objgraph.ObjectMap.load(folder)


CHEAP: dict[str, Any] = {
    "views": 2,
    "mesh_resolution": 12,
    "sampling": SAMPLING,
    "initialisation": QUICK,
    "solver": BRIEF,
    "heading_modes": None,
}


SCAN: dict[str, Any] = {
    "name": "room",
    "frames": ListedFrames([FRAME]),
    "instances": (objgraph.Instance(1, "chair"),),
    "up_world": UP,
}


def map_of(config: Mapping[str, Any], **parts: Any) -> None:
    """Map the toy scan with some parts of it, and with settings, that are others."""
    objgraph.map_scan(objgraph.Scan(**(SCAN | parts)), objgraph.MappingConfig(**(CHEAP | dict(config))))


@fuzzed
@given(data=st.data())
def test_scans_that_are_mapped(data):
    given = data.draw(arguments(SCAN))
    frames = data.draw(st.lists(wrong(FRAME) | st.just(FRAME), max_size=2).map(ListedFrames))
    instances = data.draw(st.lists(arguments({"id": 1, "category": "chair"}), max_size=2))

    def other_instances() -> None:
        map_of({}, instances=tuple(objgraph.Instance(**each) for each in instances))

    for use in (lambda: map_of({}, **given), lambda: map_of({}, frames=frames), other_instances):
        patched(lambda use=use: attempt(use))


KINDS: dict[Any, tuple[str, dict[str, Any]]] = {
    ViewSelectionConfig: ("view", {}),
    HeadingModesConfig: ("heading_modes", {}),
    AdamConfig: ("adam", {"iterations": 2, "points": 20, "rays": 20}),
}


@fuzzed
@given(data=st.data())
def test_settings_of_mapping(data):
    kind = data.draw(st.sampled_from([objgraph.MappingConfig, *KINDS]))
    given = data.draw(settings_of(kind))

    def use() -> None:
        if kind is objgraph.MappingConfig:
            map_of(given)
            return
        name, cheap = KINDS[kind]
        map_of({name: kind(**(cheap | given)), "estimator": "adam" if kind is AdamConfig else "graph"})

    patched(lambda: attempt(use))
