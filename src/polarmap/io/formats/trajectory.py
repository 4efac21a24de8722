"""Camera trajectories: TUM, KITTI, EuRoC and Redwood files, their dialects, and the pose at a time.

tum     `t tx ty tz qx qy qz qw` a line, seconds, separated by spaces
kitti   the 12 numbers of the first three rows of T_world_camera a line, or the 16 of all four, no times; with 13 or 17
        the first is a time or a frame's number
euroc   CSV, `t, tx, ty, tz, qw, qx, qy, qz` a line, nanoseconds, further columns ignored
log     five lines a pose: three whole numbers, the third the frame's counted from 1, then T_world_camera, 4×4
        (Redwood, Open3D)

Columns may be separated by blanks, tabs, commas or semicolons; a header that names them decides which is which
(`trajectory_columns`). Times may be seconds, milli-, micro- or nanoseconds, or dates. Empty lines and lines
that begin with #, % or // are skipped. Every pose is taken as camera to world, OpenCV axes, in metres (or the unit that
the map shall have).
"""

from __future__ import annotations

import logging
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from polarmap.data.times import Timestamp, all_nanoseconds
from polarmap.data.trajectory import Trajectory
from polarmap.errors import InputError
from polarmap.io.files import write_bytes
from polarmap.io.formats.text_table import TextTable, read_table
from polarmap.io.formats.times import seconds_text
from polarmap.io.formats.trajectory_columns import NAMED, PoseColumns, find_columns
from polarmap.io.formats.trajectory_times import read_times

log = logging.getLogger(__name__)

_HEADERS = {
    "tum": "# t tx ty tz qx qy qz qw\n",
    "kitti": "",
    "euroc": "#timestamp [ns],tx [m],ty [m],tz [m],qw,qx,qy,qz\n",
    "log": "",
}
FORMATS = tuple(_HEADERS)
_LOG_COLUMNS = 3
_UNITS = {"tum": "s", "euroc": "ns"}
_LARGEST = 1e20  # of all numbers, so that single precision holds them; nanoseconds since 1970 are 2e18
_ROTATION_TOLERANCE = 0.02  # of a quaternion's norm or RᵀR; three decimals keep below 0.002


def read_trajectory(
    path: Path,
    format: str = "auto",
    timestamps: Sequence[float] | None = None,
    indices: Sequence[int] | None = None,
) -> Trajectory:
    """The trajectory in a file.

    format: tum, kitti, euroc or log, or auto: by its header and columns. A header that names the columns goes before,
        and so do times of this century, whose unit is clear.
    timestamps: seconds of the frames that the poses are for. The poses of a KITTI or log file, which has no times, are
        those of the frames one by one; without `timestamps` the pose's index is its time, in a log file that of its
        frame, counted from 0. They also tell relative times in other units than seconds.
    indices: numbers of the frames, in the order of `timestamps`; a file may give them in place of times.
    Raises InputError naming file and line where a column is missing, a number is none or not finite, a rotation is
    none, or time does not increase, and where the columns or the unit of time may be this or that.
    """
    path = Path(path)
    table = read_table(path)
    if not table.rows:
        raise InputError(f"{path}: no poses; expected lines of {NAMED}, see docs/formats.md")
    if format not in ("auto", *FORMATS):
        raise InputError(f"trajectory format {format!r} is not known; known are auto, {', '.join(FORMATS)}")
    if format == "log" or (format == "auto" and len(table.rows[0][1]) == _LOG_COLUMNS):
        return _parse_log(path, [(number, " ".join(fields)) for number, fields in table.rows], timestamps)
    columns = find_columns(table, format)
    _require_columns(table, columns)
    if columns.guessed:
        log.warning("%s: no header; its columns are taken for %s", path, columns.guessed)
    line_numbers = [number for number, _ in table.rows]
    poses = _table_poses(table, columns, line_numbers)
    if columns.time is None:
        return _with_times(path, poses, _given_times(path, range(len(poses)), timestamps))
    frames = None if timestamps is None or indices is None else dict(zip(indices, timestamps, strict=True))
    times, kept = read_times(table, columns, frames, _UNITS.get(format))
    return _with_times(path, poses[kept], times)


def write_trajectory(path: Path, trajectory: Trajectory, format: str = "tum") -> None:
    """Write a trajectory so that every number reads back as it is (EuRoC's times to the nanosecond).

    KITTI files keep no times, and log files number the poses from 0. Raises InputError for an unknown format,
    PolarmapError where the file cannot be written.
    """
    if format not in FORMATS:
        raise InputError(f"trajectory format {format!r} is not known; known are {', '.join(FORMATS)}")
    if format == "log":
        write_bytes(Path(path), _log_text(trajectory.poses).encode())
        return
    poses, nanoseconds = trajectory.poses, trajectory.nanoseconds.tolist()
    quaternions = Rotation.from_matrix(poses[:, :3, :3]).as_quat(canonical=True)
    if format == "kitti":
        rows = [list(map(repr, row)) for row in poses[:, :3].reshape(-1, 12).tolist()]
    elif format == "tum":
        times = map(Timestamp, trajectory.timestamps.tolist(), nanoseconds)
        numbers = np.column_stack([poses[:, :3, 3], quaternions]).tolist()
        rows = [[seconds_text(time), *map(repr, row)] for time, row in zip(times, numbers, strict=True)]
    else:
        numbers = np.column_stack([poses[:, :3, 3], quaternions[:, [3, 0, 1, 2]]]).tolist()
        rows = [[str(time), *map(repr, row)] for time, row in zip(nanoseconds, numbers, strict=True)]
    separator = "," if format == "euroc" else " "
    text = "".join(separator.join(row) + "\n" for row in rows)
    write_bytes(Path(path), (_HEADERS[format] + text).encode())


def _require_columns(table: TextTable, columns: PoseColumns) -> None:
    """InputError where a line lacks a column, or without commas has others than the first line."""
    count = len(table.rows[0][1])
    for row, (_, fields) in enumerate(table.rows):
        if len(fields) < columns.needed if table.separator else len(fields) != count:
            expected = columns.needed if table.separator else count
            raise InputError(f"{table.where(row)}: {len(fields)} columns, expected {expected} as in the first line")
    if columns.needed > count:
        raise InputError(f"{table.where(0)}: {count} columns, expected {columns.needed}")


def _table_poses(table: TextTable, columns: PoseColumns, line_numbers: list[int]) -> np.ndarray:
    """T_world_camera of each row, float64 N×4×4."""
    places = columns.pose or range(columns.matrix, columns.matrix + columns.width)
    numbers = np.array([_parse_row(table, row, places) for row in range(len(table.rows))])
    if columns.pose:
        return _quaternion_poses(table.path, numbers[:, :3], numbers[:, 3:], line_numbers)
    if columns.width == 16:
        _require_last_row(table, numbers[:, 12:])
    return _matrix_poses(table.path, numbers[:, :12], line_numbers)


def _parse_row(table: TextTable, row: int, places: Sequence[int]) -> list[float]:
    fields = table.rows[row][1]
    return _parse_numbers(table.where(row), [fields[i] for i in places], len(places), "numbers of a pose")


def _require_last_row(table: TextTable, last: np.ndarray) -> None:
    wrong = (last != [0.0, 0.0, 0.0, 1.0]).any(axis=1)
    if wrong.any():
        where = table.where(int(np.argmax(wrong)))
        raise InputError(
            f"{where}: the matrix's last row is not 0 0 0 1; write the matrices row by row, camera to world"
        )


def _with_times(path: Path, poses: np.ndarray, times: Sequence[float]) -> Trajectory:
    return Trajectory(np.array(times, float), poses, str(path), all_nanoseconds(times))


def _parse_numbers(where: str, fields: list[str], count: int, expected: str) -> list[float]:
    if len(fields) != count:
        raise InputError(f"{where}: {len(fields)} columns, expected {count}: {expected}")
    try:
        row = [float(field) for field in fields]
    except ValueError:
        raise InputError(f"{where}: not all numbers; expected {expected}") from None
    if not all(abs(number) < _LARGEST for number in row):
        raise InputError(f"{where}: a number is NaN or infinite, or too large; leave out poses that are not known")
    return row


def _quaternion_poses(
    path: Path, translations: np.ndarray, quaternions: np.ndarray, line_numbers: list[int]
) -> np.ndarray:
    norms = np.linalg.norm(quaternions, axis=1)
    wrong = np.abs(norms - 1.0) > _ROTATION_TOLERANCE
    if wrong.any():
        i = int(np.argmax(wrong))
        raise InputError(
            f"{path}, line {line_numbers[i]}: a quaternion of norm {norms[i]:.3g}, expected 1; "
            f"a header such as '{NAMED}' names columns in another order"
        )
    return _rigid(Rotation.from_quat(quaternions), translations)


def _parse_log(path: Path, lines: list[tuple[int, str]], timestamps: Sequence[float] | None) -> Trajectory:
    frames: list[int] = []
    rows, line_numbers = [], []
    for start in range(0, len(lines), 5):
        frame, matrix = _parse_log_item(path, lines[start : start + 5])
        if timestamps is None and frames and frame <= frames[-1]:
            where = f"{path}, line {lines[start][0]}"
            raise InputError(f"{where}: frame {frame} does not come after {frames[-1]}; the third number must increase")
        frames.append(frame)
        rows.append(matrix)
        line_numbers.append(lines[start][0])
    times = _given_times(path, [frame - 1 for frame in frames], timestamps)
    return _with_times(path, _matrix_poses(path, np.array(rows), line_numbers), times)


def _parse_log_item(path: Path, item: list[tuple[int, str]]) -> tuple[int, list[float]]:
    """A frame's number and the first three rows of its matrix."""
    line_number, text = item[0]
    numbers = text.split()
    if len(numbers) != 3 or not all(re.fullmatch(r"[+-]?[0-9]{1,15}", number) for number in numbers):
        raise InputError(f"{path}, line {line_number}: {text[:40]!r} are not three whole numbers before a matrix")
    if len(item) < 5:
        raise InputError(f"{path}, line {line_number}: {len(item) - 1} lines after it, expected the matrix's four")
    rows = [
        _parse_numbers(f"{path}, line {number}", row.split(), 4, "a row of a 4x4 matrix") for number, row in item[1:]
    ]
    if rows[3] != [0.0, 0.0, 0.0, 1.0]:
        raise InputError(f"{path}, line {item[4][0]}: the matrix's last row is not 0 0 0 1")
    return int(numbers[2]), [*rows[0], *rows[1], *rows[2]]


def _log_text(poses: np.ndarray) -> str:
    return "".join(
        f"{i} {i} {i + 1}\n" + "".join(" ".join(map(repr, row)) + "\n" for row in pose)
        for i, pose in enumerate(poses.tolist())
    )


def _given_times(path: Path, indices: Sequence[int], timestamps: Sequence[float] | None) -> Sequence[float]:
    times = list(map(float, indices)) if timestamps is None else list(timestamps)
    if len(times) != len(indices):
        raise InputError(
            f"{path}: {len(indices)} poses, but {len(times)} timestamps for them; "
            "a file without times needs a pose for each frame (TUM and EuRoC files have times)"
        )
    return times


def _matrix_poses(path: Path, table: np.ndarray, line_numbers: list[int]) -> np.ndarray:
    matrices = table.reshape(-1, 3, 4)
    R = matrices[:, :, :3]
    deviation = np.abs(R.transpose(0, 2, 1) @ R - np.eye(3)).max(axis=(1, 2))
    wrong = (deviation > _ROTATION_TOLERANCE) | (np.linalg.det(R) < 0)
    if wrong.any():
        line_number = line_numbers[int(np.argmax(wrong))]
        raise InputError(f"{path}, line {line_number}: not a rotation; expected the rows of a camera's 4x4 matrix")
    return _rigid(Rotation.from_matrix(R), matrices[:, :, 3])


def _rigid(rotations: Rotation, translations: np.ndarray) -> np.ndarray:
    poses = np.tile(np.eye(4), (len(translations), 1, 1))
    poses[:, :3, :3] = rotations.as_matrix()
    poses[:, :3, 3] = translations
    return poses
