"""The sequences of a benchmark: opened where they are, or made first by `polarmap synth` and kept."""

from __future__ import annotations

import json
import shlex
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

from polarmap.benchmark.cells import Cell
from polarmap.benchmark.spec import expanded
from polarmap.errors import InputError, PolarmapError
from polarmap.io.files import reason, write_bytes
from polarmap.io.formats.json_text import read_json
from polarmap.io.recording.camera_file import read_camera_file
from polarmap.io.recording.sequence import Sequence, open_sequence

MADE_NAME = "made_by.json"
"""In a made sequence: what it was made from. Only folders that hold it are ever replaced."""

MakeSequence = Callable[[list[str], Path], None]
"""Runs `polarmap synth` with these arguments in this folder; PolarmapError where that fails."""


def open_cell_sequence(cell: Cell, out: Path, spec_folder: Path, make: MakeSequence) -> Sequence:
    """The frames that a cell is about; a sequence that has to be made is, once for each seed.

    Raises InputError where the sequence cannot be read or has none of the frames, PolarmapError where it cannot be
    made.
    """
    spec = cell.sequence
    path = Path(spec.path) if spec.path else _made(cell, out, spec_folder, make)
    camera_file = None if spec.camera is None else read_camera_file(Path(spec.camera), path)
    sequence = open_sequence(path, camera_file)
    frames = sequence[spec.frame_slice]
    if len(frames) == 0:
        raise InputError(f"{path}: has {len(sequence)} frames, and none of {spec.frames}; correct frames in the spec")
    return frames


def _made(cell: Cell, out: Path, spec_folder: Path, make: MakeSequence) -> Path:
    folder = out.absolute() / "sequences" / f"{cell.sequence.name}_seed{cell.seed}"
    made_from: dict[str, Any] = {"synth": cell.sequence.synth_arguments, "seed": cell.seed}
    if _made_from(folder) == made_from:
        return folder
    part = folder.with_name(folder.name + ".part")
    arguments = [expanded(argument, f"sequence {cell.sequence.name}: synth") for argument in made_from["synth"]]
    try:
        if part.exists():  # of a benchmark that was interrupted
            shutil.rmtree(part)
        if folder.exists():
            _remove_made(folder)
        part.parent.mkdir(parents=True, exist_ok=True)
        make([*arguments, str(part), "--seed", str(cell.seed)], spec_folder)
        if not part.is_dir():
            raise PolarmapError(f"sequence {cell.sequence.name}: 'polarmap synth {shlex.join(arguments)}' makes none")
        write_bytes(part / MADE_NAME, json.dumps(made_from).encode())
        part.rename(folder)
    except OSError as error:
        raise PolarmapError(f"{error.filename or part}: cannot be written ({reason(error)})") from None
    return folder


def _made_from(folder: Path) -> dict | None:
    try:
        return read_json(folder / MADE_NAME)
    except InputError:
        return None


def _remove_made(folder: Path) -> None:
    if not (folder / MADE_NAME).exists():
        raise InputError(f"{folder}: is in the way and was not made by a benchmark; move it away")
    shutil.rmtree(folder)
