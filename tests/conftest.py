"""Fixtures that several test files share."""

from __future__ import annotations

import os
from pathlib import Path

import numba
import pytest
from command_line import CommandLine

if "PYTEST_XDIST_WORKER" in os.environ:  # the other processes keep the other cores busy
    numba.set_num_threads(1)

SHARED = Path(__file__).resolve().parents[2] / "shared"


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The folder of recorded sequences beside the repository; the test is skipped where it is missing."""
    if not (SHARED / "data").is_dir():
        pytest.skip("the recorded sequences (../shared/data) are not on this machine")
    return SHARED / "data"


@pytest.fixture(scope="session")
def shared_models() -> Path:
    """The folder of prior networks beside the repository; the test is skipped where it is missing."""
    if not (SHARED / "models").is_dir():
        pytest.skip("the prior networks (../shared/models) are not on this machine")
    return SHARED / "models"


@pytest.fixture
def polarmap(monkeypatch, capsys) -> CommandLine:
    """Run a command line: `polarmap("run", sequence, "--out", out)` gives its exit status, stdout and stderr."""
    return CommandLine(monkeypatch, capsys)
