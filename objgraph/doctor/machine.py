"""The program and the machine it runs on: versions, processor, memory, GPU, priors."""

import os
import platform
import re
from collections.abc import Iterator
from importlib.metadata import PackageNotFoundError, requires, version
from pathlib import Path

import torch
from packaging.requirements import Requirement

from objgraph.doctor.section import Finding, Section
from objgraph.errors import PriorError
from objgraph.priors.registry import WEIGHTS, available_priors
from objgraph.priors.store import load_prior_file
from objgraph.version import program_version

_FEATURES = ("avx2", "avx512f", "avx512_bf16", "amx_tile", "amx_bf16", "neon", "asimd", "sve", "bf16")
"""What torch's kernels choose by, as Linux names it: of x86, then of ARM."""
_PACKAGE = "objgraph"
_HASH = 12
"""Digits of a prior's hash that are shown."""


def examine_machine() -> list[Section]:
    """The program, its packages, the machine and the shipped priors."""
    return [_program(), _packages(), _machine(), _priors()]


def _program() -> Section:
    rows = (
        ("objgraph", program_version()),
        ("Python", f"{platform.python_version()} on {platform.system()}"),
    )
    return Section("Program", rows)


def _packages() -> Section:
    """The packages that the program needs, then each extra by name."""
    needed = _requirements()
    if not needed:
        why = Finding(
            _PACKAGE, "is not installed, so what it needs is not known", "pip install objgraph", True
        )
        return Section("Packages", findings=(why,))
    rows = [(each.name, _installed(each)) for extra, each in needed if extra is None]
    findings = [
        Finding(
            each.name, f"{_installed(each)}; {each.name}{each.specifier} is needed", "pip install objgraph"
        )
        for extra, each in needed
        if extra is None and not _satisfied(each)
    ]
    extras = sorted({extra for extra, _ in needed if extra is not None})
    rows += [(f"extra {extra}", _extra(extra, needed)) for extra in extras]
    return Section("Packages", tuple(rows), tuple(findings))


def _requirements() -> list[tuple[str | None, Requirement]]:
    """Each with the extra it is for; None for what is always needed. Empty where the program is not installed."""
    try:
        lines = requires(_PACKAGE) or []
    except PackageNotFoundError:
        return []
    found = []
    for line in lines:
        requirement = Requirement(line)
        extra = re.search(r"extra == ['\"]([^'\"]+)['\"]", line)
        if requirement.name != _PACKAGE:
            found.append((extra[1] if extra else None, requirement))
    return found


def _installed(requirement: Requirement) -> str:
    try:
        return version(requirement.name)
    except PackageNotFoundError:
        return "missing"


def _satisfied(requirement: Requirement) -> bool:
    found = _installed(requirement)
    return found != "missing" and requirement.specifier.contains(found, prereleases=True)


def _extra(extra: str, needed: list[tuple[str | None, Requirement]]) -> str:
    missing = [each.name for name, each in needed if name == extra and not _satisfied(each)]
    return f"lacks {', '.join(missing)}: pip install 'objgraph[{extra}]'" if missing else "there"


def _machine() -> Section:
    cpu = _cpu_info()
    flags = set((cpu.get("flags") or cpu.get("Features") or "").split())
    features = " ".join(name for name in _FEATURES if name in flags)
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    rows = [
        ("processor", processor()),
        ("features", features or "unknown"),
        ("cores", f"{cores} of {os.cpu_count()}"),
        ("memory", _memory()),
        ("torch", f"{torch.get_num_threads()} threads, {torch.backends.cpu.get_cpu_capability()} kernels"),
        *(("GPU", gpu) for gpu in _gpus()),
    ]
    return Section("Machine", tuple(rows))


def processor() -> str:
    """Its name, as the system gives it."""
    return _cpu_info().get("model name") or platform.processor() or platform.machine()


def _cpu_info() -> dict[str, str]:
    """Of the first core, where the system says it in a file."""
    try:
        text = Path("/proc/cpuinfo").read_text(errors="replace")
    except OSError:
        return {}
    pairs = (line.partition(":") for line in text.split("\n\n")[0].splitlines())
    return {key.strip(): value.strip() for key, _, value in pairs}


def _memory() -> str:
    try:
        page, pages = os.sysconf("SC_PAGE_SIZE"), os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, OSError, ValueError):  # not every system has these
        return "unknown"
    return f"{page * pages / 2**30:.1f} GiB"


def _gpus() -> Iterator[str]:
    if not torch.cuda.is_available():
        yield "none that torch can use (none is needed)"
        return
    for i in range(torch.cuda.device_count()):
        device = torch.cuda.get_device_properties(i)
        yield f"{device.name}, {device.total_memory / 2**30:.0f} GiB, CUDA {torch.version.cuda}"


def _priors() -> Section:
    rows, findings = [], []
    for category in available_priors():
        path = WEIGHTS / f"{category}.safetensors"
        try:
            rows.append((category, f"sha256 {load_prior_file(path).card['sha256'][:_HASH]}"))
        except PriorError as error:
            findings.append(Finding(str(path), str(error), "install the program again"))
    if not rows and not findings:
        findings.append(Finding(str(WEIGHTS), "no shape prior is here", "install the program again"))
    return Section("Shape priors", tuple(rows), tuple(findings))
