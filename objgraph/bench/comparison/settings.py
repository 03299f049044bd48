"""Rows of other settings are not mixed: what each was made with is noted beside them."""

import json
from collections.abc import Callable, Hashable, Mapping
from pathlib import Path
from typing import Any

from objgraph.bench.comparison.config import differences, digest
from objgraph.bench.comparison.rows import R, RowFile, write_text
from objgraph.errors import EvaluationError

SETTINGS = "settings.json"
"""The file, by digest."""


def refuse_other_settings(
    file: RowFile[R], settings: Mapping[Any, Mapping[str, Any]], kind: Callable[[R], Hashable]
) -> None:
    """Note the settings that rows of each kind are now made with; raises EvaluationError where the file has others."""
    out = file.path.parent
    noted = _read(out / SETTINGS)
    for row in file.rows:
        now = settings.get(kind(row))
        if now is not None and row.settings != digest(now):
            words = differences(noted.get(row.settings, {}), now) if row.settings in noted else ["not noted"]
            raise EvaluationError(
                f"{out} holds rows of '{row.method}' made with other settings or weights ({'; '.join(words)}): "
                "give another --out, or delete that folder"
            )
    noted |= {digest(each): each for each in settings.values()}
    write_text(json.dumps(noted, indent=1) + "\n", out / SETTINGS)


def _read(path: Path) -> dict[str, Any]:
    try:
        return json.loads(path.read_text())
    except FileNotFoundError:
        return {}
    except (OSError, ValueError) as error:
        raise EvaluationError(f"{path} is damaged ({error}): delete it") from error
