"""Every text can be written, whatever the terminal's encoding."""

from __future__ import annotations

import io
import os
import sys
from pathlib import Path

import pytest
from command_line import run_python

from polarmap.cli.streams import ascii_of, make_streams_tolerant

SOURCES = Path(__file__).resolve().parents[2] / "src" / "polarmap"
PLAIN = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
ENVIRONMENTS = [PLAIN, {"PYTHONIOENCODING": "ascii:strict"}, {"PYTHONIOENCODING": "latin-1:strict"}]


def written(text, encoding, monkeypatch):
    stream = io.TextIOWrapper(io.BytesIO(), encoding=encoding, errors="strict", newline="\n")
    monkeypatch.setattr(sys, "stdout", stream)
    monkeypatch.setattr(sys, "stderr", io.StringIO())
    make_streams_tolerant()
    stream.write(text)
    stream.flush()
    return stream.buffer.getvalue()


@pytest.mark.parametrize(
    ("text", "encoding", "expected"),
    [
        ("┏━┓ σ = 0.5°, 8×8 – ok… é", "ascii", b"+-+ sigma = 0.5 deg, 8x8 - ok... e"),
        ("σ = 0.5°, é", "latin-1", b"sigma = 0.5\xb0, \xe9"),
        ("σ é \udcff\ud800", "utf-8", "σ é \\xff?".encode()),
        ("漢字 ⠋", "ascii", b"?? ?"),
    ],
)
def test_the_nearest_ascii_takes_its_place(text, encoding, expected, monkeypatch):
    assert written(text, encoding, monkeypatch) == expected


def test_every_character_of_the_sources_has_an_ascii():
    characters = {c for path in SOURCES.rglob("*.py") for c in path.read_text("utf-8") if ord(c) > 127}
    assert len(characters) > 10
    for character in characters:
        assert ascii_of(character).isascii()
    assert {c for c in characters if ascii_of(c) == "?"} <= set("⊗∂∈∝∫"), "give them a meaning in cli/streams.py"


@pytest.mark.parametrize("environment", ENVIRONMENTS)
def test_help_and_tables_of_all_commands(environment, tmp_path):
    """In one process for each encoding, since each start takes seconds."""
    program = (
        "import sys\n"
        "from polarmap.cli import main\n"
        "commands = [['--help'], ['config'], ['config', '--yaml'], ['synth', 'scene', '--list'],\n"
        "    *([*name.split(), '--help'] for name in ('run', 'odometry', 'eval', 'bench', 'inspect', 'config',\n"
        "    'demo', 'synth', 'synth rgbd', 'synth scene', 'synth mitsuba')), ['inspect', sys.argv[1]]]\n"
        "for command in commands:\n"
        "    sys.argv = ['polarmap', *command]\n"
        "    try:\n"
        "        main()\n"
        "    except SystemExit as ended:\n"
        "        print('status', ended.code or 0, flush=True)\n"
    )
    missing = os.fsencode(tmp_path) + b"/nowhere-\xff-\xc3\xa9"
    ended = run_python(program, missing, **environment)
    assert ended.status == 0, ended.err
    assert "Traceback" not in ended.err + ended.out
    statuses = [line for line in ended.out.splitlines() if line.startswith("status")]
    assert statuses == ["status 0"] * 15 + ["status 2"]
    assert "nowhere-" in ended.err and "no such file" in ended.err
    if environment is PLAIN:
        assert "│" not in ended.out and "+----" in ended.out
