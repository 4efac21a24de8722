"""What odometry alone leaves: a trajectory file per segment, and its sparse points (docs/odometry.md)."""

from __future__ import annotations

import io
import os
import re
from dataclasses import fields
from pathlib import Path

import numpy as np

from polarmap.data.odometry import OdometryResult, SparsePoints
from polarmap.data.times import all_nanoseconds
from polarmap.data.trajectory import PosedFrame, Trajectory
from polarmap.errors import InputError
from polarmap.io.files import write_bytes
from polarmap.io.formats.ply import write_ply
from polarmap.io.formats.trajectory import write_trajectory
from polarmap.io.run_folder.folder import segment_file

POINT_SUFFIXES = (".ply", ".npz")


def segment_trajectory(result: OdometryResult, segment: int, keyframes_only: bool = False) -> Trajectory | None:
    """The poses of a segment's frames, or of its keyframes alone; None where there is none."""
    frames = [f for f in result.frames if f.segment == segment and (f.is_keyframe or not keyframes_only)]
    return _trajectory(frames, segment) if frames else None


def write_segments(
    path: Path, result: OdometryResult, format: str = "tum", keyframes_only: bool = False
) -> tuple[Path, ...]:
    """Write the segment with most frames to `path`, segment N of the others to STEM_segmentN.SUFFIX beside it.

    format: as of `write_trajectory`. Returns the files written. Raises as `write_trajectory` does.
    """
    written = []
    for segment in result.segments:
        trajectory = segment_trajectory(result, segment, keyframes_only)
        if trajectory is not None:
            written.append(_beside(path, segment, result))
            write_trajectory(written[-1], trajectory, format)
    return tuple(written)


def write_points(path: Path, result: OdometryResult) -> tuple[Path, ...]:
    """Write the sparse points: a PLY per segment, named as by `write_segments`, or all arrays in one .npz.

    A PLY has position, grey as colour, and `inverse_depth_std`. Returns the files written.
    Raises InputError for another suffix, PolarmapError where a file cannot be written.
    """
    check_points_name(path)
    if path.suffix == ".npz":
        _write_npz(path, result.points)
        return (path,)
    written = []
    for segment in result.segments:
        points, chosen = result.points, result.points.segment == segment
        written.append(_beside(path, segment, result))
        write_ply(
            written[-1],
            points.position[chosen].reshape(-1, 3),
            grey=points.intensity[chosen],
            properties={"inverse_depth_std": points.inverse_depth_std[chosen]},
        )
    return tuple(written)


def check_points_name(path: Path) -> None:
    """Raise InputError unless points can be written to a file of this name."""
    if path.suffix not in POINT_SUFFIXES:
        raise InputError(f"{path}: points are written as {' or '.join(POINT_SUFFIXES)}; choose such a name")


def prepare_file(path: Path, force: bool = False) -> None:
    """Check, before any work is done, that an output file and its segments' can be written.

    With `force` those of earlier runs are removed. Raises InputError where the folder is missing or may not be written
    to, the name is a folder's, or a file is there and `force` is not set.
    """
    folder = path.parent
    if not folder.is_dir() or not os.access(folder, os.W_OK | os.X_OK):
        problem = "may not be written to" if folder.is_dir() else "is no folder"
        raise InputError(f"{path}: {folder} {problem}; choose another place or make it first")
    if path.is_dir():
        raise InputError(f"{path}: is a folder; name a file")
    for existing in _earlier(path):
        if not force:
            raise InputError(f"{existing}: exists; choose another name, or replace it with --force")
        existing.unlink()


def _earlier(path: Path) -> list[Path]:
    segments = re.compile(rf"{re.escape(path.stem)}_segment\d+{re.escape(path.suffix)}")
    return [
        p for p in sorted(path.parent.iterdir()) if p.is_file() and (p.name == path.name or segments.fullmatch(p.name))
    ]


def _beside(path: Path, segment: int, result: OdometryResult) -> Path:
    return path.with_name(segment_file(path.name, segment, result.segments[0]))


def _trajectory(frames: list[PosedFrame], segment: int) -> Trajectory:
    times = np.array([frame.timestamp for frame in frames])
    poses = np.array([frame.T_world_camera for frame in frames])
    exact = all_nanoseconds(frame.timestamp for frame in frames)
    return Trajectory(times, poses, f"odometry, segment {segment}", exact)


def _write_npz(path: Path, points: SparsePoints) -> None:
    buffer = io.BytesIO()
    np.savez(buffer, **{field.name: getattr(points, field.name) for field in fields(points)})
    write_bytes(path, buffer.getbuffer())
