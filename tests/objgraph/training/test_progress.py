import pytest

from objgraph.training import progress
from objgraph.training.progress import bars


def test_where_there_is_no_terminal_lines_say_how_far_it_is(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    seconds = iter(range(0, 1000, 20))
    monkeypatch.setattr(progress.time, "monotonic", lambda: float(next(seconds)))
    with bars("sofas: ") as report:
        for step in range(1, 9):
            report(f"training, loss {1 / step:.2f}", step, 8)
        report("drawing", 1, 5)
    assert capsys.readouterr().out.splitlines() == [
        "sofas: training, loss 1.00: 1 of 8",
        "sofas: training, loss 0.25: 4 of 8",
        "sofas: training, loss 0.14: 7 of 8",
        "sofas: training, loss 0.12: 8 of 8",
        "sofas: drawing: 1 of 5",
    ]
