"""Camera trajectories: TUM, KITTI, EuRoC and Redwood files, their dialects, and the pose at a time.

tum     `t tx ty tz qx qy qz qw` a line, seconds, separated by spaces
kitti   the 12 numbers of the first three rows of T_world_camera a line, or the 16 of all four, no times; with 13 or 17
        the first is a time or a frame's number
euroc   CSV, `t, tx, ty, tz, qw, qx, qy, qz` a line, nanoseconds, further columns ignored
log     five lines a pose: three whole numbers, the third the frame's counted from 1, then T_world_camera, 4×4
        (Redwood, Open3D)

Columns may be separated by blanks, tabs, commas or semicolons; a header that names them decides which is which
(`polarmap.io.trajectory_columns`). Times may be seconds, milli-, micro- or nanoseconds, or dates. Empty lines and lines
that begin with #, % or // are skipped. Every pose is taken as camera to world, OpenCV axes, in metres (or the unit that
the map shall have).
"""

from __future__ import annotations

import logging
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from polarmap.errors import InputError
from polarmap.io.files import write_bytes
from polarmap.io.text_table import TextTable, read_table
from polarmap.io.times import MOST_SECONDS, Timestamp, all_nanoseconds, seconds_text, typical_step
from polarmap.io.trajectory_columns import NAMED, PoseColumns, find_columns
from polarmap.io.trajectory_times import read_times

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
_LEAST_GAP = 0.1  # seconds
_SLOWEST_STEP = 0.51  # seconds between poses; interpolation across more is a guess
_GAP_STEPS = 1.5
_ROUNDING = 2e-6  # seconds, of times with six decimals


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Poses of the camera over time.

    timestamps: seconds, strictly increasing, float64 N.
    poses: T_world_camera, float64 N×4×4.
    source: the file they came from, for messages.
    nanoseconds: the same times exactly, int64 N; None for those of the timestamps' shortest decimal numbers.
    Raises InputError where the shapes do not fit, a number is not finite, or time does not increase.
    """

    timestamps: np.ndarray
    poses: np.ndarray
    source: str = "trajectory"
    nanoseconds: np.ndarray | None = None

    def __post_init__(self) -> None:
        count = len(self.timestamps)
        if count == 0 or np.shape(self.timestamps) != (count,) or np.shape(self.poses) != (count, 4, 4):
            raise InputError(f"{self.source}: needs at least one pose, and one timestamp for each")
        if not (np.isfinite(self.timestamps).all() and np.isfinite(self.poses).all()):
            raise InputError(f"{self.source}: timestamps and poses must be finite")
        if np.abs(self.timestamps).max() > MOST_SECONDS:
            raise InputError(f"{self.source}: timestamps beyond {MOST_SECONDS:g} s; are they in nanoseconds?")
        if self.nanoseconds is None:
            object.__setattr__(self, "nanoseconds", all_nanoseconds(np.asarray(self.timestamps).tolist()))
        if ((np.diff(self.timestamps) <= 0) & (np.diff(self.nanoseconds) <= 0)).any():
            raise InputError(f"{self.source}: timestamps must increase from pose to pose")

    def __len__(self) -> int:
        return len(self.timestamps)

    @cached_property
    def longest_gap(self) -> float:
        """Seconds between two poses up to which the motion between them is known.

        It is one and a half times the median step, so that the rate of the poses decides and a pose that is missing
        makes a gap; at least 0.1 s, and that where the poses are fewer than two a second.
        """
        step = typical_step(self.timestamps) if len(self) > 2 else None
        usual = _LEAST_GAP if step is None or step > _SLOWEST_STEP else max(_LEAST_GAP, _GAP_STEPS * step)
        return usual + _ROUNDING

    def at(self, timestamp: float, max_difference: float = 0.02, max_gap: float | None = None) -> np.ndarray | None:
        """T_world_camera at a time, float64 4×4, or None where the trajectory does not know it.

        Between two poses that are at most `max_gap` seconds apart (`longest_gap` if None), the position is
        interpolated linearly and the rotation along the shortest arc; elsewhere it is the nearest pose, at most
        `max_difference` seconds away. Raises InputError where `timestamp` is NaN, as it is in a sequence without times.
        """
        if math.isnan(timestamp):
            raise InputError(
                f"{self.source}: the frames have no times to look poses up by; "
                "add timestamps.txt to the sequence or frame_rate to its camera file"
            )
        after = int(np.searchsorted(self.timestamps, timestamp))
        before = max(after - 1, 0)
        after = min(after, len(self) - 1)
        if self.timestamps[after] == timestamp:
            return self.poses[after].copy()
        if before < after and self.timestamps[after] - self.timestamps[before] <= (max_gap or self.longest_gap):
            return self._interpolated(before, after, timestamp)
        nearest = min(before, after, key=lambda i: abs(self.timestamps[i] - timestamp))
        if abs(self.timestamps[nearest] - timestamp) > max_difference + _ROUNDING:
            return None
        return self.poses[nearest].copy()

    def why_unknown(self, timestamp: float) -> str:
        """Why `at` knows no pose at a time: it lies outside the trajectory's times, or in a gap between them."""
        if self.timestamps[0] <= timestamp <= self.timestamps[-1]:
            return "its time is in a gap of the trajectory"
        return "its time is outside the trajectory's times"

    def require_overlap(self, timestamps: Sequence[float], max_difference: float = 0.02) -> None:
        """Raise InputError, with both ranges of time, unless `at` knows one of these timestamps at least."""
        if any(self.at(timestamp, max_difference) is not None for timestamp in timestamps):
            return
        raise InputError(
            f"{self.source}: poses from {self.timestamps[0]:.6f} to {self.timestamps[-1]:.6f} s, but frames "
            f"from {min(timestamps):.6f} to {max(timestamps):.6f} s; both must be seconds of the same clock"
        )

    def _interpolated(self, before: int, after: int, timestamp: float) -> np.ndarray:
        times, poses = self.timestamps[[before, after]], self.poses[[before, after]]
        share = (timestamp - times[0]) / (times[1] - times[0])
        T = np.eye(4)
        T[:3, :3] = Slerp([0.0, 1.0], Rotation.from_matrix(poses[:, :3, :3]))(share).as_matrix()
        T[:3, 3] = (1.0 - share) * poses[0, :3, 3] + share * poses[1, :3, 3]
        return T


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
    frames, rows, line_numbers = [], [], []
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
