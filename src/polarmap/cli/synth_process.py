"""`polarmap synth` in a process of its own, for a benchmark that makes its sequences.

A benchmark measures times and memory for hours. What a renderer takes (compiled kernels, Mitsuba with its threads, the
scene) would stay with the process; that of a child is free again when it ends, and a crash there costs one sequence.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from polarmap.errors import PolarmapError


def run_synth(arguments: list[str], folder: Path) -> None:
    """Run `polarmap synth` with these arguments in this folder; PolarmapError with its message where that fails."""
    command = [sys.executable, "-m", "polarmap", "synth", *arguments]
    environment = {**os.environ, "COLUMNS": "1000"}  # messages in one line
    ended = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, errors="replace")
    if ended.returncode != 0:
        raise PolarmapError(f"polarmap synth {' '.join(arguments)}: {last_message(ended.stderr)}")


def last_message(text: str) -> str:
    """What a command said last, without the frame that the command line's own messages have."""
    lines = [stripped for line in text.splitlines() if (stripped := line.strip(" │╭╮╰╯─"))]
    return lines[-1].removeprefix("polarmap: ") if lines else "ended without a message"
