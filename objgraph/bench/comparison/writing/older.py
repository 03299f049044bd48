"""Figures of earlier runs under the names that their methods have now."""

import re
from collections.abc import Mapping
from typing import Any

_NOW_DAMPED = "dsp-slam-gn"
_NAMED = re.compile(rf"(?<![\w-]){_NOW_DAMPED}(?![\w-])")


def renamed(document: dict[str, Any]) -> dict[str, Any]:
    """A comparison's JSON, in which what was called `dsp-slam-gn` and had no damping is `dsp-slam-gn-undamped`, with each of its
    starts and differences.

    The settings that the document keeps tell; where it keeps none the rows are older. Its command stays as it was typed.
    """
    settings = document.get("methods") or document.get("settings") or {}
    own = [each for name, each in settings.items() if name.partition("@")[0] == _NOW_DAMPED]
    if own and all(_found(each, "damping") for each in own):
        return document
    return {key: value if key == "command" else _undamped(value) for key, value in document.items()}


def _undamped(value: Any) -> Any:
    if isinstance(value, str):
        return _NAMED.sub(f"{_NOW_DAMPED}-undamped", value)
    if isinstance(value, dict):
        return {_undamped(key): _undamped(item) for key, item in value.items()}
    return [_undamped(item) for item in value] if isinstance(value, list) else value


def _found(settings: Any, name: str) -> Any:
    """A setting at whatever depth; None where there is none."""
    if not isinstance(settings, Mapping):
        return None
    inner = (_found(value, name) for value in settings.values())
    return settings[name] if name in settings else next((each for each in inner if each is not None), None)
