"""The program as a whole: its version and its help."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError

import pytest


def test_the_version_is_told(polarmap, monkeypatch):
    monkeypatch.setattr("polarmap.version.version", lambda package: {"polarmap": "1.2.3"}[package])
    assert polarmap("--version") == (0, "polarmap 1.2.3\n", "")


def test_a_version_that_is_not_known_is_no_error(polarmap, monkeypatch):
    def missing(package):
        raise PackageNotFoundError(package)

    monkeypatch.setattr("polarmap.version.version", missing)
    status, printed, error = polarmap("--version")
    assert (status, error) == (0, "")
    assert printed.startswith("polarmap ") and "not installed" in printed


@pytest.mark.parametrize(
    "command", ["run", "odometry", "eval", "export", "bench", "inspect", "config", "demo", "synth"]
)
def test_every_command_teaches(polarmap, command):
    status, printed, _ = polarmap(command, "--help")
    assert status == 0 and f"polarmap {command}" in printed
