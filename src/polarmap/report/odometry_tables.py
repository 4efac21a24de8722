"""What odometry did with a sequence, as tables for the terminal."""

from __future__ import annotations

from rich.console import Group, RenderableType
from rich.table import Table

from polarmap.data.odometry import OdometryResult
from polarmap.data.trajectory import Trajectory
from polarmap.evaluation.gaps import gaps
from polarmap.evaluation.sparse import SparseEvaluation
from polarmap.evaluation.trajectories import compare_trajectories
from polarmap.io.run_folder.odometry_files import segment_trajectory


def odometry_tables(
    result: OdometryResult, truth: Trajectory | None = None, sparse: SparseEvaluation | None = None
) -> RenderableType:
    """Segments, gaps and times, to be printed by rich; with true poses the error of each segment, with `sparse` that of
    the points' depth."""
    parts = [_segment_table(result, truth)]
    if sparse is not None:
        parts.append(_sparse_table(sparse))
    if result.without_pose:
        parts.append(_gap_table(result))
    if result.milliseconds:
        parts.append(_time_table(result))
    return Group(*parts)


def _segment_table(result: OdometryResult, truth: Trajectory | None) -> Table:
    total = len(result.frames) + len(result.without_pose)
    title = f"{len(result.frames)} of {total} frames tracked, {len(result.points.position)} points"
    columns = ["segment", "from frame", "to frame", "frames", "keyframes"]
    table = _table(title, *columns, *(("ATE Sim(3)", "scale", "true poses") if truth is not None else ()))
    for segment in result.segments:
        frames = [frame for frame in result.frames if frame.segment == segment]
        keyframes = sum(frame.is_keyframe for frame in frames)
        row = [segment, frames[0].index, frames[-1].index, len(frames), keyframes]
        table.add_row(*map(str, row), *(_error(result, segment, truth) if truth is not None else ()))
    return table


def _error(result: OdometryResult, segment: int, truth: Trajectory) -> tuple[str, str, str]:
    """Error, scale, and how many of the segment's poses have a true pose at their time."""
    poses = segment_trajectory(result, segment)
    metrics = compare_trajectories(poses, truth)
    met = f"{0 if metrics is None else metrics.poses} of {len(poses)}"
    if metrics is None or metrics.similar != metrics.similar:
        return "–", "–", met
    return f"{metrics.similar:.4f} m", f"{metrics.scale:.4f}", met


def _sparse_table(sparse: SparseEvaluation) -> Table:
    title = f"Depth of points, {len(sparse.keyframes)} keyframes"
    table = _table(title, "AbsRel", "RMSE", "points per image")
    table.add_row(f"{sparse.depth.abs_rel:.4f}", f"{sparse.depth.rmse:.4f} m", f"{sparse.depth.points:.0f}")
    return table


def _gap_table(result: OdometryResult) -> Table:
    table = _table("Without a pose", "from frame", "to frame", "frames", "reason")
    table.columns[-1].justify = "left"
    for gap in gaps(result):
        table.add_row(str(gap.first), str(gap.last), str(gap.frames), gap.reason)
    return table


def _time_table(result: OdometryResult) -> Table:
    frames = len(result.frames) + len(result.without_pose)
    table = _table("Time per frame", *result.milliseconds, "all")
    times = [*result.milliseconds.values(), sum(result.milliseconds.values())]
    table.add_row(*(f"{time / max(frames, 1):.1f} ms" for time in times))
    return table


def _table(title: str, *headings: str) -> Table:
    table = Table(title=title, title_justify="left")
    for heading in headings:
        table.add_column(heading, justify="right")
    return table
