"""Camera trajectories: TUM, KITTI, EuRoC and Redwood files, and the pose at a time.

tum     `t tx ty tz qx qy qz qw` a line, seconds, separated by spaces
kitti   the 12 numbers of the first three rows of T_world_camera a line, no times
euroc   CSV, `t, tx, ty, tz, qw, qx, qy, qz` a line, nanoseconds, further columns ignored
log     five lines a pose: three whole numbers, the third the frame's counted from 1, then T_world_camera, 4×4
        (Redwood, Open3D)

Empty lines and lines that begin with # are skipped. Every pose is taken as camera to world, OpenCV axes, in
metres (or the unit that the map shall have).
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from polarmap.errors import InputError
from polarmap.io.files import data_lines, write_bytes

_COLUMNS = {
    "tum": "t tx ty tz qx qy qz qw, separated by spaces",
    "kitti": "r11 r12 r13 tx r21 r22 r23 ty r31 r32 r33 tz",
    "euroc": "t [ns], tx, ty, tz, qw, qx, qy, qz, separated by commas",
    "log": "three whole numbers, then the 4x4 matrix in four lines",
}
_COLUMN_COUNTS = {"tum": 8, "kitti": 12, "euroc": 8, "log": 3}
_LARGEST = 1e20  # of all numbers, so that single precision holds them; nanoseconds since 1970 are 2e18
_ROTATION_TOLERANCE = 0.02  # of a quaternion's norm or RᵀR; three decimals keep below 0.002


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Poses of the camera over time.

    timestamps: seconds, strictly increasing, float64 N.
    poses: T_world_camera, float64 N×4×4.
    source: the file they came from, for messages.
    Raises InputError where the shapes do not fit, a number is not finite, or time does not increase.
    """

    timestamps: np.ndarray
    poses: np.ndarray
    source: str = "trajectory"

    def __post_init__(self) -> None:
        count = len(self.timestamps)
        if count == 0 or np.shape(self.timestamps) != (count,) or np.shape(self.poses) != (count, 4, 4):
            raise InputError(f"{self.source}: needs at least one pose, and one timestamp for each")
        if not (np.isfinite(self.timestamps).all() and np.isfinite(self.poses).all()):
            raise InputError(f"{self.source}: timestamps and poses must be finite")
        if (np.diff(self.timestamps) <= 0).any():
            raise InputError(f"{self.source}: timestamps must increase from pose to pose")

    def __len__(self) -> int:
        return len(self.timestamps)

    def at(self, timestamp: float, max_difference: float = 0.02, max_gap: float = 0.1) -> np.ndarray | None:
        """T_world_camera at a time, float64 4×4, or None where the trajectory does not know it.

        Between two poses that are at most `max_gap` seconds apart, the position is interpolated linearly and
        the rotation along the shortest arc; elsewhere it is the nearest pose, at most `max_difference`
        seconds away. Raises InputError where `timestamp` is NaN, as it is in a sequence without times.
        """
        if math.isnan(timestamp):
            raise InputError(
                f"{self.source}: the frames have no times to look poses up by; "
                "add timestamps.txt to the sequence or frame_rate to its camera file"
            )
        after = int(np.searchsorted(self.timestamps, timestamp))
        before = max(after - 1, 0)
        after = min(after, len(self) - 1)
        if 0 < self.timestamps[after] - self.timestamps[before] <= max_gap:
            return self._interpolated(before, after, timestamp)
        nearest = min(before, after, key=lambda i: abs(self.timestamps[i] - timestamp))
        if abs(self.timestamps[nearest] - timestamp) > max_difference:
            return None
        return self.poses[nearest].copy()

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


def read_trajectory(path: Path, format: str = "auto", timestamps: Sequence[float] | None = None) -> Trajectory:
    """The trajectory in a file.

    format: tum, kitti, euroc or log, or auto: by what the first line looks like.
    timestamps: seconds of each pose of a KITTI or log file, which has none; else the pose's index is its time,
        in a log file that of its frame, counted from 0.
    Raises InputError naming file and line where a column is missing, a number is none or not finite, a
    rotation is none, or time does not increase.
    """
    path = Path(path)
    lines = data_lines(path)
    if not lines:
        raise InputError(f"{path}: no poses; expected lines of {_COLUMNS['tum']}")
    if format == "auto":
        format = _guess_format(path, *lines[0])
    if format not in _COLUMNS:
        raise InputError(f"trajectory format {format!r} is not known; known are auto, {', '.join(_COLUMNS)}")
    if format == "log":
        return _parse_log(path, lines, timestamps)
    table = np.array([_parse_line(path, number, text, format) for number, text in lines])
    line_numbers = [number for number, _ in lines]
    if format == "kitti":
        times = _given_times(path, range(len(table)), timestamps)
        return Trajectory(times, _matrix_poses(path, table, line_numbers, format), str(path))
    quaternions = table[:, 4:] if format == "tum" else table[:, [5, 6, 7, 4]]
    poses = _quaternion_poses(path, table[:, 1:4], quaternions, line_numbers, format)
    times = table[:, 0] if format == "tum" else table[:, 0] / 1e9
    _check_increasing(path, times, line_numbers)
    return Trajectory(times, poses, str(path))


def write_trajectory(path: Path, trajectory: Trajectory, format: str = "tum") -> None:
    """Write a trajectory so that every number reads back as it is (EuRoC's times to the nanosecond).

    KITTI files keep no times, and log files number the poses from 0. Raises InputError for an unknown format,
    PolarmapError where the file cannot be written.
    """
    if format not in _COLUMNS:
        raise InputError(f"trajectory format {format!r} is not known; known are {', '.join(_COLUMNS)}")
    if format == "log":
        write_bytes(Path(path), _log_text(trajectory.poses).encode())
        return
    times, poses = trajectory.timestamps, trajectory.poses
    quaternions = Rotation.from_matrix(poses[:, :3, :3]).as_quat(canonical=True)
    if format == "kitti":
        rows = poses[:, :3].reshape(-1, 12).tolist()
    elif format == "tum":
        rows = np.column_stack([times, poses[:, :3, 3], quaternions]).tolist()
    else:
        numbers = np.column_stack([poses[:, :3, 3], quaternions[:, [3, 0, 1, 2]]]).tolist()
        rows = [[round(t * 1e9), *row] for t, row in zip(times.tolist(), numbers, strict=True)]
    separator = "," if format == "euroc" else " "
    text = "".join(separator.join(map(repr, row)) + "\n" for row in rows)
    header = "" if format == "kitti" else f"# {_COLUMNS[format]}\n"
    write_bytes(Path(path), (header + text).encode())


def _guess_format(path: Path, line_number: int, text: str) -> str:
    if "," in text:
        return "euroc"
    columns = len(text.split())
    for name in ("tum", "kitti", "log"):
        if columns == _COLUMN_COUNTS[name]:
            return name
    known = "; ".join(f"{name}: {what}" for name, what in _COLUMNS.items())
    raise InputError(f"{path}, line {line_number}: {columns} columns are none of the known formats ({known})")


def _parse_line(path: Path, line_number: int, text: str, format: str) -> list[float]:
    where = f"{path}, line {line_number}"
    fields = text.split("," if format == "euroc" else None)
    count = _COLUMN_COUNTS[format]
    return _parse_numbers(where, fields[:count] if format == "euroc" else fields, count, _COLUMNS[format])


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
    path: Path, translations: np.ndarray, quaternions: np.ndarray, line_numbers: list[int], format: str
) -> np.ndarray:
    norms = np.linalg.norm(quaternions, axis=1)
    wrong = np.abs(norms - 1.0) > _ROTATION_TOLERANCE
    if wrong.any():
        i = int(np.argmax(wrong))
        raise InputError(
            f"{path}, line {line_numbers[i]}: a quaternion of norm {norms[i]:.3g}, expected 1; "
            f"the columns are {_COLUMNS[format]}"
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
    return Trajectory(times, _matrix_poses(path, np.array(rows), line_numbers, "log"), str(path))


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


def _given_times(path: Path, indices: Sequence[int], timestamps: Sequence[float] | None) -> np.ndarray:
    times = np.array(indices if timestamps is None else timestamps, float)
    if len(times) != len(indices):
        raise InputError(
            f"{path}: {len(indices)} poses, but {len(times)} timestamps for them; "
            "a file without times needs a pose for each frame (TUM and EuRoC files have times)"
        )
    return times


def _matrix_poses(path: Path, table: np.ndarray, line_numbers: list[int], format: str) -> np.ndarray:
    matrices = table.reshape(-1, 3, 4)
    R = matrices[:, :, :3]
    deviation = np.abs(R.transpose(0, 2, 1) @ R - np.eye(3)).max(axis=(1, 2))
    wrong = (deviation > _ROTATION_TOLERANCE) | (np.linalg.det(R) < 0)
    if wrong.any():
        line_number = line_numbers[int(np.argmax(wrong))]
        raise InputError(f"{path}, line {line_number}: not a rotation; expected {_COLUMNS[format]}")
    return _rigid(Rotation.from_matrix(R), matrices[:, :, 3])


def _rigid(rotations: Rotation, translations: np.ndarray) -> np.ndarray:
    poses = np.tile(np.eye(4), (len(translations), 1, 1))
    poses[:, :3, :3] = rotations.as_matrix()
    poses[:, :3, 3] = translations
    return poses


def _check_increasing(path: Path, times: np.ndarray, line_numbers: list[int]) -> None:
    backward = np.diff(times) <= 0
    if backward.any():
        i = int(np.argmax(backward)) + 1
        raise InputError(
            f"{path}, line {line_numbers[i]}: time {times[i]} s does not come after {times[i - 1]} s; "
            "sort the lines and remove duplicates"
        )
