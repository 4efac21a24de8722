"""The program as its users call it: a command line in this process, or Python code in a process of its own."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import pytest

from polarmap import cli

SOURCES = Path(cli.__file__).parents[2]


class Ended(NamedTuple):
    """What came of a call."""

    status: int
    out: str
    err: str


class CommandLine:
    """`polarmap ARGUMENTS` in this process; the fixture `polarmap`. A bug raises what it would print a traceback of."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
        self._monkeypatch = monkeypatch
        self._capsys = capsys

    def __call__(self, *arguments: object) -> Ended:
        self._monkeypatch.setattr(sys, "argv", ["polarmap", *map(str, arguments)])
        with pytest.raises(SystemExit) as ended:
            cli.main()
        output = self._capsys.readouterr()
        assert "Traceback" not in output.err
        return Ended(ended.value.code or 0, output.out, output.err)


def refused(ended: Ended, *words: object, status: int = 2) -> None:
    """That a call ended with this status and one line that holds these words."""
    assert ended.status == status
    lines = [line for line in ended.err.strip().splitlines() if not line.startswith("Compiling for this machine")]
    assert len(lines) == 1
    for word in words:
        assert str(word) in ended.err


def run_python(program: str | Path, *arguments: str | bytes, timeout: float = 300, **environment: str) -> Ended:
    """Run a text or a file of Python, which may import the package, with these variables beside the usual ones.

    A status below 0 is that of the signal that ended it. Bytes that are no UTF-8 become surrogates.
    """
    command = [sys.executable, *(["-c", program] if isinstance(program, str) else [program]), *arguments]
    variables = os.environ | {"PYTHONPATH": str(SOURCES)} | environment
    ended = subprocess.run(command, env=variables, capture_output=True, timeout=timeout)
    out, err = (text.decode("utf-8", "surrogateescape") for text in (ended.stdout, ended.stderr))
    return Ended(ended.returncode, out, err)
