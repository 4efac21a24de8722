"""The folder of a run: names, room made for it, and what is written to it and read back (see docs/output.md)."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from contextlib import nullcontext
from pathlib import Path

import numpy as np
from pydantic import ValidationError

from polarmap.errors import InputError, PolarmapError
from polarmap.geometry.pose import to_quaternion
from polarmap.io.files import reason, remove_parts, write_bytes
from polarmap.io.folder_lock import LOCK_NAME, FolderLock
from polarmap.io.formats.json_text import read_json_text
from polarmap.io.formats.times import seconds_text
from polarmap.io.recording.camera_file import CAMERA_FILE_NAME
from polarmap.io.run_folder.keyframe_file import KeyframeResult, read_keyframe
from polarmap.io.run_folder.results import RunResults

RESULTS_NAME = "results.json"
CONFIG_NAME = "config.yaml"
TRAJECTORY_NAME = "trajectory.txt"
KEYFRAMES_NAME = "keyframes.txt"
MESH_NAME = "mesh.ply"
CLOUD_NAME = "cloud.ply"
OFFSET_NAME = "offset.xyz"
REPORT_NAME = "report.html"
EVALUATION_NAME = "evaluation.json"

TUM_HEADER = "# t tx ty tz qx qy qz qw, seconds, metres, camera to world\n"
ODOMETRY_TUM_HEADER = "# t tx ty tz qx qy qz qw, seconds, units of odometry, camera to world\n"

_FILES = (
    RESULTS_NAME, CONFIG_NAME, TRAJECTORY_NAME, KEYFRAMES_NAME, MESH_NAME, CLOUD_NAME, OFFSET_NAME, REPORT_NAME,
    EVALUATION_NAME,
)  # fmt: skip
_SEGMENT_FILE = re.compile(
    r"(trajectory|keyframes)_segment\d+\.txt|(mesh|cloud)_segment\d+\.ply|offset_segment\d+\.xyz"
)
_FOLDERS = {
    "keyframes": re.compile(r"\d{6,}\.npz"),
    "depth": re.compile(r"\d{6,}\.png"),
    "pictures": re.compile(r"(\d{6,}|map)_[a-z]+\.(jpg|png)"),
}

_PAGE = 4096  # bytes that the system writes at once, whatever kills the process meanwhile


def write_results(out: Path, results: RunResults) -> None:
    """Write results.json; PolarmapError where that fails."""
    write_bytes(out / RESULTS_NAME, (results.model_dump_json(indent=1) + "\n").encode())


def read_results(out: Path) -> RunResults:
    """The results.json of a run's folder; InputError where there is none or it is not one of a run."""
    path = Path(out) / RESULTS_NAME
    if not os.path.exists(path):
        raise InputError(f"{out}: no {RESULTS_NAME} in it; name the folder that 'polarmap run --out' wrote")
    try:
        return RunResults.model_validate_json(read_json_text(path), strict=True)
    except ValidationError as error:
        problem = error.errors()[0]
        where = ".".join(str(part) for part in problem["loc"])
        raise InputError(f"{path}: not the results of a run ({where or 'its whole'}: {problem['msg']})") from None


def read_keyframes(out: Path, size: tuple[int, int] | None = None) -> Iterator[KeyframeResult]:
    """The keyframes of a run in the order of their index, one in memory at a time.

    size: the (width, height) that they must have, if known. Raises InputError where there is none or, when it comes
    to it, a file is malformed.
    """
    files = keyframe_files(out)
    if not files:
        raise InputError(f"{out}: no keyframes in it (keyframes/NNNNNN.npz)")
    return (read_keyframe(file, size) for file in files.values())


def keyframe_files(out: Path) -> dict[int, Path]:
    """The files of a run's keyframes by their index, in its order; empty where there is none."""
    files = _written_by_a_run(Path(out) / "keyframes")
    return dict(sorted((int(path.stem), path) for path in files))


def prepare_output(out: Path, force: bool = False, lock: FolderLock | None = None) -> None:
    """Make the folder of a run and its sub-folders. lock: taken before anything in it is touched, freed on an error.

    With `force` the files of an earlier run are removed, and never any other. Raises InputError where the folder
    is not empty and `force` is not set, holds other files under a run's names, is a sequence, or cannot be written.
    """
    try:
        out.mkdir(parents=True, exist_ok=True)
        with lock.on_error() if lock else nullcontext():
            _make_room(out, force)
    except OSError as error:
        raise InputError(f"{out}: cannot be used for output ({reason(error)}); choose another folder") from None


def _make_room(out: Path, force: bool) -> None:
    if any(path.name != LOCK_NAME for path in out.iterdir()):
        _clear(out, force)
    for name in _FOLDERS:
        (out / name).mkdir(exist_ok=True)
    for folder in (out, *(out / name for name in _FOLDERS)):
        if not os.access(folder, os.W_OK | os.X_OK):
            raise InputError(f"{folder}: may not be written to; choose another folder or change its permissions")


def segment_file(name: str, segment: int, main: int = 0) -> str:
    """The name of a segment's own file: as it is for the main one, else such as mesh_segment2.ply for segment 2."""
    path = Path(name)
    return name if segment == main else f"{path.stem}_segment{segment}{path.suffix}"


def tum_line(timestamp: float, T_world_camera: np.ndarray) -> str:
    """A pose as a line of a TUM file, every number such that it reads back as it is."""
    translation, quaternion = to_quaternion(T_world_camera)
    numbers = [repr(float(number)) for number in (*translation, *quaternion)]
    return " ".join([seconds_text(timestamp), *numbers]) + "\n"


def append_line(path: Path, line: str) -> None:
    """Append a line to a text file, whole or not at all, even if the process is killed; PolarmapError where that fails.

    A write that lies within a page cannot be cut short by a signal; now and then, where it would not, the file is
    written anew.
    """
    data = line.encode()
    try:
        with open(path, "ab", buffering=0) as file:
            size = file.tell()
            if size // _PAGE != (size + len(data) - 1) // _PAGE:
                write_bytes(path, path.read_bytes() + data)
                return
            if file.write(data) != len(data):
                file.truncate(size)
                raise OSError("the disk is full")
    except OSError as error:
        raise PolarmapError(f"{path}: cannot be written ({reason(error)})") from None


def _clear(out: Path, force: bool) -> None:
    if os.path.exists(out / CAMERA_FILE_NAME):
        raise InputError(f"{out}: is a sequence ({CAMERA_FILE_NAME}); choose another folder for the output")
    if not force:
        raise InputError(f"{out}: is not empty; choose another folder, or replace the run in it with --force")
    for folder in (out, *(out / name for name in _FOLDERS)):
        remove_parts(folder)
    written = [path for name in _FILES if os.path.lexists(path := out / name)]
    written += [path for path in out.iterdir() if _SEGMENT_FILE.fullmatch(path.name)]
    written += [path for name in _FOLDERS for path in _written_by_a_run(out / name)]
    if not written:
        return
    try:
        read_results(out)
    except InputError:
        raise InputError(f"{written[0]}: is in the way and not of a run; choose another folder") from None
    for path in reversed(written):  # results.json last: until then the folder is a run's
        path.unlink()


def _written_by_a_run(folder: Path) -> list[Path]:
    """Files in one of a run's sub-folders that have the names a run gives."""
    if not folder.is_dir():
        return []
    return [path for path in folder.iterdir() if _FOLDERS[folder.name].fullmatch(path.name)]
