"""How mapping keeps up with a camera: the real-time factor of a whole run, and latencies of live ones.

    python benchmarks/bench_live.py [--sequence FOLDER] [--sizes 640x480 1224x1024] [--repeats 3]

Renders the built-in room at each size, 80 frames of a hand that moves 1.5 cm from one to the next (0.45 m/s), and plays
them forth and back until there are 300, at 30 a second: 10 s, in which the camera turns round without slowing down, and
sees the same pictures, noise included, several times. At the larger size polarization cameras usually give fewer frames
a second. A recording is played once, as it is and at its own pace.

All is compiled and loaded before (`polarmap warmup`), and poses are found by odometry. Rendered frames are read from
raw buffers, which is about as cheap as taking them from a camera; those of a recording are decoded as they are, from
PNG files for instance. The run's folder is written as `polarmap run` does it. Figures are medians over the repeats.

Real-time factor: seconds of the recording, from its first frame to its last, divided by the seconds that a run takes
which is not live, maps every keyframe, and waits for all: reading, odometry, mapping, mesh, and writing with the
report. Above 1 it is faster than the camera.
The other rows are of live runs (`polarmap run --realtime`), whose frames come at their times and are lost while too
many wait; keyframes are skipped while mapping is behind. Targets are those for 640x480 at 30 frames a second.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter

import numpy as np
from rich.console import Console
from rich.table import Table
from rooms import FRAME_RATE, forth_and_back, recorded_room

from polarmap.errors import PolarmapError
from polarmap.io.recording.replay import Replay
from polarmap.io.recording.sequence import Sequence, open_sequence
from polarmap.io.run_folder.folder import read_results
from polarmap.io.run_folder.results import RunResults
from polarmap.pipeline.config import Config
from polarmap.pipeline.poses.found import odometry_poses
from polarmap.prior.names import DEFAULT_PRIOR
from polarmap.prior.priors import make_prior
from polarmap.report.run_writer import RunWriter
from polarmap.run import require_times, run_live, run_sequence
from polarmap.warm_up import warm_up

SIZES = ((640, 480), (1224, 1024))
STEP = 0.015  # metres from frame to frame
FACTOR = "real-time factor"
TARGETS = {
    FACTOR: "1 or more",
    "exposure to pose, ms: median": "35",
    "exposure to pose, ms: 99 %": "100",
    "keyframe to surface, s: median": "1.5",
}


def main() -> None:
    arguments = _arguments()
    warm_up()
    runs = {}
    for name, sequence in _recordings(arguments):
        seconds = float(np.ptp(sequence.timestamps))
        factors = [seconds / _seconds_of_run(sequence) for _ in range(arguments.repeats)]
        live = [_live_figures(sequence) for _ in range(arguments.repeats)]
        runs[name] = {"seconds of recording": seconds, FACTOR: float(np.median(factors))}
        runs[name] |= {row: float(np.median([run[row] for run in live])) for row in live[0]}
    Console().print(_table(runs, arguments.repeats))


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sequence", type=Path, help="a recording to play instead of the room")
    parser.add_argument("--sizes", nargs="+", type=_size, default=SIZES, help="default: 640x480 1224x1024")
    parser.add_argument("--rendered", type=int, default=80, help="frames that are rendered (default: 80)")
    parser.add_argument("--frames", type=int, default=300, help="frames that are played (default: 300)")
    parser.add_argument("--repeats", type=int, default=3)
    return parser.parse_args()


def _size(text: str) -> tuple[int, int]:
    width, height = (int(number) for number in text.split("x"))
    return width, height


def _recordings(arguments: argparse.Namespace) -> Iterator[tuple[str, Sequence]]:
    """Name and recording, one after the other; what was rendered is there until the next one is asked for."""
    if arguments.sequence:
        recording = open_sequence(arguments.sequence)
        require_times(recording)
        yield "recording", recording
        return
    for width, height in arguments.sizes:
        with TemporaryDirectory() as folder:
            rendered = recorded_room(Path(folder) / "room", width, height, arguments.rendered, STEP)
            yield f"{width}x{height}", forth_and_back(rendered, arguments.frames, FRAME_RATE)


def _seconds_of_run(sequence: Sequence) -> float:
    """Wall time of a whole run that is not live, by odometry."""
    prior, poses = make_prior(DEFAULT_PRIOR, Config().prior), odometry_poses(sequence.camera_file)
    with _writer(sequence) as writer:
        start = perf_counter()
        run_sequence(sequence, poses, writer, prior)
        return perf_counter() - start


def _live_figures(sequence: Sequence) -> dict[str, float]:
    """Rows of the table, of one live run by odometry."""
    prior = make_prior(DEFAULT_PRIOR, Config().prior)
    poses = odometry_poses(sequence.camera_file, side_by_side=True)
    with _writer(sequence) as writer:
        run_live(Replay(sequence), poses, writer, prior)
        return _rows(read_results(writer.out))


def _rows(results: RunResults) -> dict[str, float]:
    live = results.live
    if live is None or live.pose is None or live.surface is None:
        raise PolarmapError("a live run without poses or without surface has no latencies")
    return {
        "frames": results.frames,
        "frames without a pose": results.frames - results.posed,
        "frames missed": live.missed,
        "keyframes mapped": len(results.keyframes),
        "keyframes mapped in a hurry": live.hurried,
        "keyframes skipped": live.skipped,
        "exposure to pose, ms: median": live.pose.median,
        "exposure to pose, ms: 99 %": live.pose.p99,
        "keyframe to surface, s: median": live.surface.median / 1000,
        "keyframe to surface, s: largest": live.surface.largest / 1000,
        "map after the last frame, s": live.after,
    }


@contextmanager
def _writer(sequence: Sequence) -> Iterator[RunWriter]:
    """Writes a run to a folder that is removed in the end."""
    with TemporaryDirectory() as out:
        yield RunWriter(Path(out) / "run", Config(), sequence.camera_file.camera, poses="odometry")


def _table(runs: dict[str, dict[str, float]], repeats: int) -> Table:
    caption = f"{FACTOR}: seconds of recording / seconds of a run that maps every keyframe; the rest: live runs"
    table = Table("", "target", *runs, title=f"odometry and mapping, medians of {repeats}", caption=caption)
    for column in table.columns[1:]:
        column.justify = "right"
    for row in next(iter(runs.values())):
        table.add_row(row, TARGETS.get(row, ""), *(_number(run[row]) for run in runs.values()))
    return table


def _number(value: float) -> str:
    return f"{value:g}" if value == round(value) else f"{value:.2f}" if value < 10 else f"{value:.1f}"


if __name__ == "__main__":
    main()
