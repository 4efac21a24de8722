"""The command line: polarmap run, odometry, eval, bench, inspect, config, demo, synth."""

from __future__ import annotations

import errno
import logging
import os
import shlex
import sys
from contextlib import suppress
from pathlib import Path
from typing import Annotated, Literal

import typer
from rich.table import Table

from polarmap.cli.bench import bench
from polarmap.cli.common import (
    CameraPath,
    ConfigPath,
    Force,
    Interrupted,
    Out,
    SequencePath,
    Settings,
    WarningLines,
    console,
    making,
    messages,
    progress_bar,
    stop_requests,
    warn,
)
from polarmap.cli.streams import make_streams_tolerant
from polarmap.cli.synth import synth_app
from polarmap.errors import InputError, NothingMapped, PolarmapError, concise
from polarmap.interrupts import raise_stopped, stopped_status, was_stopped
from polarmap.prior.names import DEFAULT_PRIOR

# Commands import what they use, so that --help and `config` answer at once.

app = typer.Typer(
    help="Dense maps from a moving polarization camera.",
    epilog="Start with 'polarmap demo --out demo', then 'polarmap inspect' on your own recording.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="markdown",
)
app.add_typer(synth_app, name="synth")
TrajectoryFormat = Literal["tum", "kitti", "euroc", "log"]
ResultsFormat = Literal["auto", "polarmap", "colmap", "openmvs", "depth-png", "depth-npy", "ply", "trajectory"]
ScaleRule = Literal["auto", "as-is", "trajectory", "median"]


@app.command()
def run(
    sequence: SequencePath,
    out: Out,
    poses: Annotated[
        Path | None,
        typer.Option(
            help="Trajectory of the camera: TUM, KITTI, EuRoC or log file; odometry if not given.", metavar="FILE"
        ),
    ] = None,
    prior: Annotated[
        str, typer.Option(help="'polarnet', 'sparse', or a relative depth network as an ONNX file (docs/priors.md).")
    ] = DEFAULT_PRIOR,
    config: ConfigPath = None,
    settings: Settings = None,
    camera: CameraPath = None,
    stages: Annotated[
        bool, typer.Option("--stages", help="Also keep the depth after each step, which 'eval' then compares.")
    ] = False,
    force: Force = False,
) -> None:
    """Map a recorded sequence.

    Reads raw polarization mosaics; writes depth maps, normals, a mesh, figures, and a report to look at
    (OUT/report.html). Poses come from a trajectory, or without --poses from odometry, up to one scale: lengths
    are then in units of odometry, not in metres. The true depth and poses of a sequence are never read unless --poses
    names them.

    Examples: polarmap run livingroom --out out

    polarmap run livingroom --poses livingroom/groundtruth.txt --out out
    """
    from polarmap.io.recording.sequence import open_sequence
    from polarmap.prior.priors import make_prior
    from polarmap.sensing.front_end import require_polarization

    parameters = _parameters(config, settings)
    recording = open_sequence(sequence, _camera_file(camera, sequence))
    require_polarization(recording.camera_file)
    trajectory = None if poses is None else recording.read_poses(poses)
    _map(recording, trajectory, make_prior(prior, parameters.prior), parameters, out, stages, force)


@app.command()
def odometry(
    sequence: SequencePath,
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
) -> None:
    """Find the camera's poses in a recorded sequence, of a polarization camera or a plain one.

    They are up to one scale. Where odometry is lost it begins anew with another world and scale: the segment with most
    frames is written to FILE, segment N of the others beside it with _segmentN in its name.

    Example: polarmap odometry livingroom --out trajectory.txt --points points.ply
    """
    from polarmap.io.recording.sequence import open_sequence
    from polarmap.io.run_folder.odometry_files import check_points_name, prepare_file
    from polarmap.pipeline.poses.found import calibrated_front_end, make_odometry
    from polarmap.run import require_times

    parameters = _parameters(config, settings)
    recording = open_sequence(sequence, _camera_file(camera, sequence))
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


@app.command("eval")
def evaluate(
    out: Annotated[
        Path,
        typer.Argument(metavar="OUT", help="Folder that 'polarmap run' or another program wrote, or a file of it."),
    ],
    sequence: SequencePath,
    json_file: Annotated[
        Path | None, typer.Option("--json", help="Also write all figures there.", metavar="FILE")
    ] = None,
    format: Annotated[ResultsFormat, typer.Option("--format", help="What wrote OUT; found out if not given.")] = "auto",
    scale: Annotated[
        ScaleRule,
        typer.Option(
            "--scale", help="How another program's depth is scaled: by its trajectory if it has one, or as named."
        ),
    ] = "auto",
    depth_scale: Annotated[
        float | None,
        typer.Option("--depth-scale", help="Values per metre of depth-png and depth-npy files.", metavar="VALUES"),
    ] = None,
    with_map: Annotated[
        bool, typer.Option("--map", help="Also accuracy and completeness of the mesh or cloud; some seconds more.")
    ] = False,
    thresholds: Annotated[
        list[float] | None,
        typer.Option("--threshold", help="Distance in metres for --map; may be repeated.", metavar="METRES"),
    ] = None,
    with_walls: Annotated[
        bool, typer.Option("--walls", help="Also how flat walls are reconstructed; some seconds more.")
    ] = False,
    per_keyframe: Annotated[bool, typer.Option("--keyframes", help="Also a line for each keyframe.")] = False,
    camera: CameraPath = None,
) -> None:
    """Compare a run, or another program's results, with the true depth and poses of the sequence.

    Other programs: COLMAP (dense workspace or sparse model), OpenMVS (\\*.dmap), depth maps as 16-bit PNG or
    .npy by the frames' names, a .ply of points or triangles, a trajectory file.

    Examples: polarmap eval out livingroom --json figures.json

    polarmap eval colmap/dense livingroom --map
    """
    from polarmap.evaluation.evaluate import write_evaluation
    from polarmap.evaluation.measure import evaluate_results
    from polarmap.evaluation.surface import THRESHOLDS
    from polarmap.io.recording.sequence import open_sequence
    from polarmap.report.evaluation_tables import evaluation_tables

    evaluation = evaluate_results(
        out,
        open_sequence(sequence, _camera_file(camera, sequence)),
        format=format,
        scale=scale,
        depth_scale=depth_scale,
        with_map=with_map,
        with_walls=with_walls,
        thresholds=tuple(sorted(thresholds)) if thresholds else THRESHOLDS,
    )
    console.print(evaluation_tables(evaluation, per_keyframe))
    if json_file is not None:
        write_evaluation(json_file, evaluation)


app.command()(bench)


@app.command()
def inspect(
    sequence: SequencePath,
    camera: CameraPath = None,
    out: Annotated[Path | None, typer.Option(help="Folder for pictures of S0, DoLP and AoLP.", metavar="OUT")] = None,
    samples: Annotated[int, typer.Option(min=1, help="Frames to look at, spread over the sequence.")] = 5,
) -> None:
    """Say what a recording holds, and picture it.

    Saturation, darkness, degree of polarization, the residual (I0+I90)-(I45+I135), which is a few percent of S0 for a
    sound sensor, and how far noise lets the angle be known. Warns where the pictures contradict the camera file: a
    colour sensor read as grey, a mosaic cropped by an odd number, grey pictures in place of mosaics.

    Example: polarmap inspect fruits.png --camera camera.yaml --out pictures
    """
    from polarmap.io.recording.sequence import open_sequence
    from polarmap.report.inspection import inspect_sequence, inspection_table

    recording = open_sequence(sequence, _camera_file(camera, sequence))
    inspection = inspect_sequence(recording, samples, pictures_to=out)
    console.print(inspection_table(inspection))
    for finding in inspection.findings:
        warn(finding)
    if out is not None:
        console.print(f"pictures: {out}")


@app.command("config")
def show_config(
    config: ConfigPath = None,
    settings: Settings = None,
    as_yaml: Annotated[bool, typer.Option("--yaml", help="As a file for --config.")] = False,
) -> None:
    """List every parameter with its value, unit, meaning, and the paper's section it comes from.

    Example: polarmap config --yaml > config.yaml
    """
    parameters = _parameters(config, settings)
    if as_yaml:
        typer.echo(parameters.to_yaml(), nl=False)
        return
    table = Table("parameter", "value", "unit", "meaning", "paper", highlight=False)
    for entry in parameters.parameters():
        value = "auto" if entry.value is None else str(entry.value)
        changed = "" if entry.value == entry.default else "bold"
        name = f"{entry.section}.{entry.name}"
        table.add_row(name, value, entry.unit, entry.meaning, entry.source, style=changed)
    console.print(table)


@app.command()
def demo(
    out: Out = Path("demo"),
    frames: Annotated[int, typer.Option(min=2, max=1000, help="Frames to render.")] = 24,
    force: Force = False,
) -> None:
    """Render a small room with bare walls, map it, and print how accurate the map is.

    The recording goes to OUT/sequence in the format of a real one, the map to OUT/map.
    """
    from polarmap.io.recording.sequence import open_sequence
    from polarmap.prior.priors import make_prior
    from polarmap.synth.scene_recording import record_scene

    parameters = _parameters(None, None)
    folder = out / "sequence"
    with progress_bar() as progress, making(folder):
        task = progress.add_task("rendering", total=frames)
        record_scene(folder, "room", frames, force=force, on_frame=lambda: progress.advance(task))
    recording = open_sequence(folder)
    prior = make_prior(DEFAULT_PRIOR, parameters.prior)
    _map(recording, recording.truth_trajectory(), prior, parameters, out / "map", stages=True, force=force)
    _evaluate(out / "map", recording)


def _parameters(config: Path | None, settings: list[str] | None):
    from polarmap.pipeline.config import Config, read_config

    parameters = read_config(config) if config is not None else Config()
    return parameters.with_settings(settings) if settings else parameters


def _camera_file(path: Path | None, sequence: Path):
    from polarmap.io.recording.camera_file import read_camera_file

    return None if path is None else read_camera_file(path, sequence)


def _map(recording, trajectory, prior, parameters, out: Path, stages: bool, force: bool) -> None:
    from polarmap.report.run_writer import RunWriter
    from polarmap.run import run_sequence

    poses = _pose_source(recording, trajectory, parameters)
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
            with _compile_notice(), progress_bar() as progress:
                task = progress.add_task("mapping", total=len(recording))

                def advance(keyframes: int, status) -> None:
                    tracking = f", {status.value}" if trajectory is None else ""
                    progress.update(task, advance=1, description=f"mapping, {keyframes} keyframes{tracking}")

                run_sequence(recording, poses, writer, prior, parameters, advance, stop)
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


def _pose_source(recording, trajectory, parameters):
    from polarmap.pipeline.poses.found import odometry_poses
    from polarmap.run import require_times

    if trajectory is not None:
        trajectory.require_overlap(recording.timestamps)
        return trajectory
    require_times(recording)
    return odometry_poses(recording.camera_file, parameters)


def _track(recording, front_end, tracker, stop) -> None:
    from polarmap.run import track_sequence

    with _compile_notice(), progress_bar() as progress:
        task = progress.add_task("starting", total=len(recording))

        def advance(update) -> None:
            progress.update(task, advance=1, description=update.status.value)

        track_sequence(recording, front_end, tracker, advance, stop)


def _report_odometry(recording, result, true_poses, out, format, keyframes, points) -> None:
    from collections import Counter

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

    if true_poses is None or not (recording.path / "depth").is_dir():
        return None
    try:
        return evaluate_sparse(result, recording, truth=true_poses)
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


def _evaluate(out: Path, recording):
    from polarmap.evaluation.evaluate import evaluate_run
    from polarmap.report.evaluation_tables import evaluation_tables

    result = evaluate_run(out, recording)
    console.print(evaluation_tables(result))
    return result


def _compile_notice():
    from polarmap.cli.compile_notice import CompileNotice

    return CompileNotice(
        lambda: messages.print(
            "Compiling for this machine; that takes some minutes and is kept for later runs.", soft_wrap=True
        )
    )


def main() -> None:
    """Entry point: errors in one line on stderr; exit status 2 for bad input, 1 for a failure, 128 + signal."""
    make_streams_tolerant()
    raise_stopped()
    logging.basicConfig(level=logging.WARNING, handlers=[WarningLines()])
    sys.exit(_status())


def _status() -> int:
    try:
        app()
    except Interrupted as stopped:
        return _fail(str(stopped), stopped_status())
    except PolarmapError as error:
        return _fail(str(error), error.exit_status)
    except KeyboardInterrupt:
        return _fail("interrupted", stopped_status())
    except SystemExit as ended:
        if ended.code != Interrupted.exit_status:
            raise
        return _fail("interrupted", stopped_status())  # Ctrl-C before or after the work proper
    except MemoryError:
        return _fail("out of memory; try a larger fusion.voxel_size or smaller images", 1)
    except BrokenPipeError:  # whoever read the output has gone, such as 'head'
        _discard_output()
        return 1
    except OSError as error:
        if was_stopped():  # with the terminal, say
            return stopped_status()
        hint = "free some space there" if error.errno == errno.ENOSPC else "check that it exists and may be used"
        return _fail(f"{error.filename or 'output'}: {error.strerror}; {hint}", 1)
    return 0


def _fail(message: str, status: int) -> int:
    line = f"polarmap: {concise(' '.join(message.split()))}"
    with suppress(OSError):  # the terminal has gone
        messages.print(line, style="red", markup=False, highlight=False, soft_wrap=True)
    return status


def _discard_output() -> None:
    """Let nothing more be written to stdout when Python ends."""
    with suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
