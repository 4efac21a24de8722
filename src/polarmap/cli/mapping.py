"""Mapping with a progress bar, as `run` and `demo` do it."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path

from polarmap.cli.common import Interrupted, compile_notice, console, messages, progress_bar, stop_requests
from polarmap.errors import NothingMapped


def map_recording(
    recording, trajectory, prior, parameters, out: Path, stages: bool, force: bool, realtime: bool = False, watcher=None
) -> None:
    """Map a `Sequence` into the folder `out` with the poses of a `Trajectory`, or of odometry where that is None.

    realtime: its frames come as from a camera. watcher: a `Watcher` of the run, if any. Raises NothingMapped where
    there is no surface in the end, Interrupted where the user stopped it; what was done until then is written.
    """
    from polarmap.io.recording.replay import Replay
    from polarmap.report.run_writer import RunWriter
    from polarmap.run import run_live, run_sequence

    poses = _pose_source(recording, trajectory, parameters, realtime)
    replay = Replay(recording) if realtime else None
    if replay:
        _get_ready(parameters)
    with stop_requests() as stop:
        writer = RunWriter(
            out,
            parameters,
            recording.camera_file.camera,
            command=shlex.join(sys.argv),
            sequence=str(recording.path),
            poses="odometry" if trajectory is None else "given",
            pose_source="" if trajectory is None else trajectory.source,
            force=force,
            stages=stages,
        )
        try:
            with compile_notice(), progress_bar() as progress:
                task = progress.add_task("mapping", total=len(recording))

                def advance(keyframes: int, status) -> None:
                    tracking = f", {status.value}" if trajectory is None else ""
                    progress.update(task, advance=1, description=f"mapping, {keyframes} keyframes{tracking}")

                if replay:
                    run_live(replay, poses, writer, prior, parameters, advance, stop, watcher)
                else:
                    run_sequence(recording, poses, writer, prior, parameters, advance, stop, watcher)
        except KeyboardInterrupt:
            raise Interrupted(f"interrupted; {out} holds what was done until now") from None
        finally:
            _print_summary(writer.summary)
    for line in writer.summary:
        if line.level == "error":
            raise NothingMapped(line.text)


def _print_summary(lines) -> None:
    """Warnings first; what is an error is told by the command's own."""
    for line in lines:
        if line.level != "error":
            style = "yellow" if line.level == "warning" else None
            console.print(line.text, style=style, markup=False, highlight=False, soft_wrap=True)


def _get_ready(parameters) -> None:
    """Compile and load all before the first frame comes."""
    from polarmap.warm_up import warm_up

    with compile_notice(), messages.status("getting ready"):
        warm_up(parameters)


def _pose_source(recording, trajectory, parameters, realtime: bool):
    from polarmap.pipeline.poses.found import odometry_poses
    from polarmap.run import require_times

    if trajectory is not None:
        trajectory.require_overlap(recording.timestamps)
        return trajectory
    require_times(recording)
    return odometry_poses(recording.camera_file, parameters, side_by_side=realtime)
