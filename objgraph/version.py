"""Which objgraph this is."""

import subprocess
from importlib.metadata import PackageNotFoundError
from importlib.metadata import version as package_version
from pathlib import Path


def program_version() -> str:
    """The package's version, with the commit where it runs from a git checkout."""
    try:
        version = package_version("objgraph")
    except PackageNotFoundError:
        version = "unknown"
    root = Path(__file__).resolve().parents[1]
    if not (root / ".git").exists():
        return version
    command = ["git", "-C", str(root), "describe", "--always", "--dirty", "--tags"]
    try:
        commit = subprocess.run(
            command, capture_output=True, text=True, check=True, timeout=20
        ).stdout.strip()
    except (OSError, subprocess.SubprocessError):
        return version
    return f"{version}, commit {commit}"
