"""Commands that are killed again and again give in the end what they give undisturbed, and leave nothing else."""

import os
import random
import signal
from pathlib import Path

import pytest

from objgraph.atomic import UNFINISHED
from tests.reliability.children import Moment, run_in_child
from tests.reliability.commands import ARGUMENTS, Command, check_whole, outcome

KILLS = int(os.environ.get("KILLS", "0"))
_QUICK = ("segment",)
"""What is tried in every test run, a few times."""
_CHAIN = 5
"""Kills of one folder's runs before one may come to its end."""


@pytest.mark.parametrize("name", ARGUMENTS)
def test_killed_runs_give_what_an_undisturbed_one_gives(
    name: str, request: pytest.FixtureRequest, tmp_path: Path, record_property
) -> None:
    if not KILLS and name not in _QUICK:
        pytest.skip("takes minutes: make kills runs it")
    command = Command(name, request.getfixturevalue("given_map" if name == "report" else "given"))
    command.prepare(tmp_path / "whole")
    whole = run_in_child(command, tmp_path / "whole")
    assert whole.code == 0, whole.said
    expected = outcome(tmp_path / "whole", exact=name == "report")
    rng, number, done = random.Random(name), 0, 0
    while done < (KILLS or _CHAIN):
        out = tmp_path / f"killed-{number}"
        command.prepare(out)
        moments = []
        for _ in range(_CHAIN):
            moments.append(Moment.drawn(number, whole, rng))
            number += 1
            ended = run_in_child(command, out, moments[-1])
            check_whole(out)
            if _finished(command, ended.code, ended.said):
                break
            assert ended.code in (-signal.SIGKILL, 130), ended.said
            done += 1
        last = run_in_child(command, out)
        assert _finished(command, last.code, last.said), (moments, last.said)
        assert outcome(out, exact=name == "report") == expected, moments
        assert not [path for path in tmp_path.rglob("*") if UNFINISHED in path.name], moments
    record_property("kills survived", done)


def _finished(command: Command, code: int | None, said: str) -> bool:
    """What `segment` has done it does not do again."""
    return code == 0 or (command.name == "segment" and code == 1 and "already there" in said)
