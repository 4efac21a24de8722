"""Mapping with a progress bar, as `run` and `demo` do it."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
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
    from polarmap.run import run_live, run_sequence

    poses = _pose_source(recording, trajectory, parameters, realtime)
    replay = Replay(recording) if realtime else None
    if replay:
        get_ready(parameters)
    with stop_requests() as stop:
        writer = _writer(recording.camera_file, str(recording.path), trajectory, parameters, out, stages, force)
        with _mapping(writer, len(recording), trajectory is None) as advance:
            if replay:
                run_live(replay, poses, writer, prior, parameters, advance, stop, watcher)
            else:
                run_sequence(recording, poses, writer, prior, parameters, advance, stop, watcher)
    _require_surface(writer)


def map_live(
    camera, name: str, prior, parameters, out: Path, force: bool, frames: int | None, stop, watcher=None
) -> None:
    """Map what a `LiveCamera` of this name sends into the folder `out` with the poses of odometry, until it ends.

    stop: `EndRequests`. watcher: a `Watcher` of the run, if any. frames: after how many the camera ends, if that is
    known. Raises NothingMapped where there is no surface in the end.
    """
    from polarmap.pipeline.poses.found import odometry_poses
    from polarmap.run import run_live

    poses = odometry_poses(camera.camera_file, parameters, side_by_side=True)
    writer = _writer(camera.camera_file, name, None, parameters, out, False, force)
    with _mapping(writer, frames, True) as advance:
        run_live(camera, poses, writer, prior, parameters, advance, stop, watcher)
    _require_surface(writer)


def get_ready(parameters) -> None:
    """Compile and load all before the first frame comes."""
    from polarmap.warm_up import warm_up

    with compile_notice(), messages.status("getting ready"):
        warm_up(parameters)


def _writer(camera_file, name: str, trajectory, parameters, out: Path, stages: bool, force: bool):
    from polarmap.report.run_writer import RunWriter

    return RunWriter(
        out,
        parameters,
        camera_file.camera,
        command=shlex.join(sys.argv),
        sequence=name,
        poses="odometry" if trajectory is None else "given",
        pose_source="" if trajectory is None else trajectory.source,
        force=force,
        stages=stages,
    )


@contextmanager
def _mapping(writer, frames: int | None, odometry: bool) -> Iterator[Callable]:
    """While it is mapped: gives what to call after each frame. The summary is printed in the end."""
    try:
        with compile_notice(), progress_bar() as progress:
            task = progress.add_task("mapping", total=frames)

            def advance(keyframes: int, status) -> None:
                tracking = f", {status.value}" if odometry else ""
                progress.update(task, advance=1, description=f"mapping, {keyframes} keyframes{tracking}")

            yield advance
    except KeyboardInterrupt:
        raise Interrupted(f"interrupted; {writer.out} holds what was done until now") from None
    finally:
        _print_summary(writer.summary)


def _require_surface(writer) -> None:
    for line in writer.summary:
        if line.level == "error":
            raise NothingMapped(line.text)


def _print_summary(lines) -> None:
    """Warnings first; what is an error is told by the command's own."""
    for line in lines:
        if line.level != "error":
            style = "yellow" if line.level == "warning" else None
            console.print(line.text, style=style, markup=False, highlight=False, soft_wrap=True)


def _pose_source(recording, trajectory, parameters, realtime: bool):
    from polarmap.pipeline.poses.found import odometry_poses
    from polarmap.run import require_times

    if trajectory is not None:
        trajectory.require_overlap(recording.timestamps)
        return trajectory
    require_times(recording)
    return odometry_poses(recording.camera_file, parameters, side_by_side=realtime)
