"""polarmap odometry: the poses of the camera, and sparse points."""

from __future__ import annotations

import logging
from collections import Counter
from pathlib import Path
from typing import Annotated, Literal

import typer

from polarmap.cli.common import (
    CameraPath,
    ConfigPath,
    Interrupted,
    RecordingPath,
    Settings,
    compile_notice,
    console,
    progress_bar,
    read_parameters,
    stop_requests,
)
from polarmap.cli.option_groups import with_option_groups
from polarmap.cli.recording import BagOptions, open_recording
from polarmap.errors import InputError, PolarmapError

TrajectoryFormat = Literal["tum", "kitti", "euroc", "log"]


@with_option_groups
def odometry(
    sequence: RecordingPath,
    out: Annotated[Path, typer.Option("--out", help="Trajectory file to write.", metavar="FILE")],
    format: Annotated[TrajectoryFormat, typer.Option("--format", help="Format of the trajectories.")] = "tum",
    keyframes: Annotated[
        Path | None, typer.Option("--keyframes", help="Also write the poses of the keyframes there.", metavar="FILE")
    ] = None,
    points: Annotated[
        Path | None, typer.Option("--points", help="Also write the sparse points there (.ply, .npz).", metavar="FILE")
    ] = None,
    truth: Annotated[
        Path | None,
        typer.Option("--truth", help="True trajectory (TUM, KITTI, EuRoC or log), to print the error.", metavar="FILE"),
    ] = None,
    config: ConfigPath = None,
    settings: Settings = None,
    camera: CameraPath = None,
    force: Annotated[bool, typer.Option("--force", help="Replace the files if they exist.")] = False,
    *,
    bag: BagOptions,
) -> None:
    """Find the camera's poses in a recorded sequence, of a polarization camera or a plain one.

    They are up to one scale. Where odometry is lost it begins anew with another world and scale: the segment with most
    frames is written to FILE, segment N of the others beside it with _segmentN in its name.

    Example: polarmap odometry livingroom --out trajectory.txt --points points.ply
    """
    from polarmap.io.run_folder.odometry_files import check_points_name, prepare_file
    from polarmap.pipeline.poses.found import calibrated_front_end, make_odometry
    from polarmap.run import require_times

    parameters = read_parameters(config, settings)
    recording = open_recording(sequence, camera, bag)
    require_times(recording)
    true_poses = None if truth is None else recording.read_poses(truth)
    front_end = calibrated_front_end(recording.camera_file)
    if points is not None:
        check_points_name(points)
    _different(out, keyframes, points)
    for path in filter(None, (out, keyframes, points)):
        prepare_file(path, force)
    tracker = make_odometry(front_end, parameters)
    with stop_requests() as stop:
        try:
            _track(recording, front_end, tracker, stop)
        except KeyboardInterrupt:
            written = _write_odometry(tracker.result(), out, format, keyframes, points)
            done = f"{out} holds what was done until now" if written else "no frame was tracked until now"
            raise Interrupted(f"interrupted; {done}") from None
        except PolarmapError:
            _write_odometry(tracker.result(), out, format, keyframes, points)
            raise
        _report_odometry(recording, tracker.result(), true_poses, out, format, keyframes, points)


def _track(recording, front_end, tracker, stop) -> None:
    from polarmap.run import track_sequence

    with compile_notice(), progress_bar() as progress:
        task = progress.add_task("starting", total=len(recording))

        def advance(update) -> None:
            progress.update(task, advance=1, description=update.status.value)

        track_sequence(recording, front_end, tracker, advance, stop)


def _report_odometry(recording, result, true_poses, out, format, keyframes, points) -> None:
    from polarmap.report.odometry_tables import odometry_tables
    from polarmap.report.summary import frames_without_pose
    from polarmap.run import nothing_tracked

    reasons = Counter(reason for _, reason in result.without_pose)
    if not result.frames:
        raise nothing_tracked(str(recording.path), reasons)
    written = _write_odometry(result, out, format, keyframes, points)
    console.print(odometry_tables(result, true_poses, _sparse_depth(recording, result, true_poses)))
    if reasons:
        text = frames_without_pose(len(recording), len(result.frames), reasons)
        console.print(text, style="yellow", markup=False, highlight=False, soft_wrap=True)
    for path in written:
        console.print(f"written: {path}", soft_wrap=True)


def _sparse_depth(recording, result, true_poses):
    """The points against true depth; None where there is none to compare with."""
    from polarmap.evaluation.sparse import evaluate_sparse
    from polarmap.evaluation.truth import truth_of

    if true_poses is None or not (recording.path / "depth").is_dir():
        return None
    try:
        return evaluate_sparse(result, truth_of(recording, true_poses))
    except InputError as problem:
        logging.getLogger(__name__).warning("the points were not compared: %s", problem)
        return None


def _write_odometry(result, out, format, keyframes, points) -> list[Path]:
    """The files written, none if nothing was tracked."""
    from polarmap.io.run_folder.odometry_files import write_points, write_segments

    if not result.frames:
        return []
    written = [*write_segments(out, result, format)]
    if keyframes is not None:
        written += write_segments(keyframes, result, format, keyframes_only=True)
    if points is not None:
        written += write_points(points, result)
    return written


def _different(*paths: Path | None) -> None:
    named = [path.absolute() for path in paths if path is not None]
    if len(set(named)) < len(named):
        raise InputError(f"{named[0]}: named twice; give each output a name of its own")
