"""When an object is solved again as a whole: ever more rarely, whatever the map has forgotten of its views."""

from contextlib import suppress
from functools import partial
from types import SimpleNamespace

import pytest
from gtsam.symbol_shorthand import X

from factors.state import ObjectKeys
from objgraph.errors import SolveError
from objgraph.slam.incremental import system as module
from objgraph.slam.incremental.alone import Alone
from objgraph.slam.incremental.config import Tolerance
from objgraph.slam.incremental.system import IncrementalSystem
from objgraph.slam.incremental.tracked import TrackedObject
from objgraph.slam.incremental.upkeep import Upkeep
from tests.objgraph.slam.undecoded import enter, see, undecoded

FRAMES = 60


@pytest.fixture
def system(request, monkeypatch) -> IncrementalSystem:
    """With a lag of `request.param`; solving an object again fails, which must not make it due again."""

    def fail(*_, **__):
        raise SolveError("not now")

    monkeypatch.setattr(Alone, "again_in_all_headings", fail)
    monkeypatch.setattr(Alone, "again", fail)
    return undecoded(monkeypatch, request.param)


def look(system: IncrementalSystem, k: int, seen: list[TrackedObject]) -> list[str]:
    """A frame's update; the objects that were due."""
    see(system, k, seen)
    due = [entry for entry in seen if entry.is_due]
    for entry in due:
        with suppress(SolveError):
            Upkeep(system).resolve(entry, lambda: ObjectKeys.numbered(99))
    Upkeep(system).renew(seen, Tolerance())
    return [entry.name for entry in due]


@pytest.mark.parametrize("system", [3.0, 7.0, 15.0, None], indirect=True)
def test_an_object_that_is_always_seen_is_solved_again_ever_more_rarely(system):
    for k in range(2):
        look(system, k, [])
    entry = enter(system, 0, [X(0), X(1)])
    due = [k + 1 for k in range(2, FRAMES) if look(system, k, [entry])]
    assert due == [5, 9, 17, 33]


@pytest.mark.parametrize("system", [None], indirect=True)
def test_an_object_that_took_in_a_double_counts_its_views_too(system):
    """From 6 views to 12: the nine at which it would have been due were never reached."""
    for k in range(2):
        look(system, k, [])
    entries = [enter(system, i, [X(0), X(1)]) for i in range(2)]
    due = [look(system, k, entries) for k in range(2, 6)]
    assert due == [[], [], ["chair 0", "chair 1"], []]
    keep, drop = entries
    system.adopt(keep, drop.placed_views, instead_of=drop)
    assert look(system, 6, [keep]) == ["chair 0"]
    assert look(system, 7, [keep]) == []


@pytest.mark.parametrize("system", [None], indirect=True)
@pytest.mark.parametrize("whole", [False, True])
@pytest.mark.parametrize("error", [SolveError("not now"), RuntimeError("not now")])
def test_what_cannot_be_linearised_anew_is_frozen_as_it_was(system, whole, error, monkeypatch):
    """Its samples would be of where the object is by now, and its quadratic of where it was."""
    for k in range(2):
        look(system, k, [])
    entry = enter(system, 0, [X(0), X(1)])
    look(system, 2, [entry])
    points, frozen = [observation.point for observation in entry.observations], []

    def fail(*_, **__):
        raise error

    monkeypatch.setattr(module, "freeze", lambda _, values, slope: frozen.append(values))
    monkeypatch.setattr(system, "commit", fail)
    monkeypatch.setattr(TrackedObject, "departure", lambda *_: 2.0)
    found = SimpleNamespace(state=system.state(entry), turns=None)
    monkeypatch.setattr(Alone, "again_in_all_headings", lambda *_: found)
    upkeep = Upkeep(system)
    again = partial(upkeep.resolve, entry, lambda: ObjectKeys.numbered(99))
    with pytest.raises(type(error), match="not now"):
        (again if whole else partial(upkeep.renew, [entry], Tolerance()))()
    assert len(frozen) == len(points)
    assert all(point in frozen for point in points)
