"""The machine's sections: what is there, what is missing, and systems that say little of themselves."""

from importlib.metadata import PackageNotFoundError, version

import numpy as np
import pytest

from objgraph.doctor import examine_machine, machine
from objgraph.priors.registry import available_priors, load_prior

TITLES = ["Program", "Packages", "Machine", "Shape priors"]


def test_it_tells_of_program_packages_machine_and_priors():
    sections = examine_machine()
    assert [section.title for section in sections] == TITLES
    assert not [finding for section in sections for finding in section.wrong]
    priors = dict(sections[3].rows)
    assert tuple(priors) == available_priors()
    assert priors["chair"] == f"sha256 {load_prior('chair').card['sha256'][:12]}"


def requirements(monkeypatch, lines):
    monkeypatch.setattr(machine, "requires", lambda name: lines)


def test_what_is_missing_or_too_old_is_wrong(monkeypatch):
    requirements(monkeypatch, ["numpy>=99", "no-such-package>=1", "torch"])
    section = examine_machine()[1]
    assert dict(section.rows)["torch"] == version("torch")
    old, missing = section.wrong
    assert (old.where, old.what) == ("numpy", f"{np.__version__}; numpy>=99 is needed")
    assert (missing.where, missing.what) == ("no-such-package", "missing; no-such-package>=1 is needed")


def test_a_missing_extra_says_how_to_install_it(monkeypatch):
    requirements(monkeypatch, ["numpy", 'no-such-package; extra == "fun"', 'objgraph[fun]; extra == "dev"'])
    section = examine_machine()[1]
    assert section.findings == ()
    assert section.rows[1:] == (("extra fun", "lacks no-such-package: pip install 'objgraph[fun]'"),)


def test_a_program_that_is_not_installed_is_a_note(monkeypatch):
    def absent(name):
        raise PackageNotFoundError(name)

    monkeypatch.setattr(machine, "requires", absent)
    section = examine_machine()[1]
    assert section.wrong == ()
    assert "is not installed" in section.findings[0].what


def test_a_system_that_says_nothing_is_no_error(monkeypatch):
    monkeypatch.setattr(machine, "_cpu_info", dict)
    monkeypatch.delattr(machine.os, "sysconf")
    monkeypatch.setattr(machine.platform, "processor", lambda: "")
    rows = dict(examine_machine()[2].rows)
    assert rows["features"] == rows["memory"] == "unknown"
    assert rows["processor"]


@pytest.mark.parametrize("name", ["chair.safetensors", None])
def test_a_damaged_or_missing_prior_is_wrong(monkeypatch, tmp_path, name):
    if name is not None:
        (tmp_path / name).write_bytes(b"no prior")
    monkeypatch.setattr(machine, "WEIGHTS", tmp_path)
    monkeypatch.setattr(machine, "available_priors", lambda: () if name is None else ("chair",))
    (finding,) = examine_machine()[3].wrong
    assert finding.where == str(tmp_path / name if name else tmp_path)
    assert finding.do == "install the program again"
