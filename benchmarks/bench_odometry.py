"""Trajectory error and time of the odometry on recorded sequences.

    python benchmarks/bench_odometry.py ../shared/data [NAME[/STRIDE] ...] [--seeds 5] [--set points=1500 ...]

Names: office300, office450, redwood, livingroom. redwood/2 takes every other frame, redwood/-1 all of them backwards.
The error is the root mean square distance of the tracked frames' positions from the truth after the best similarity,
in the segment with most frames.
"""

from __future__ import annotations

import argparse
import re
import time
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Table
from videos import VIDEOS, Video, load

from polarmap.data.odometry import OdometryResult
from polarmap.data.trajectory import PosedFrame
from polarmap.evaluation.metrics import trajectory_metrics
from polarmap.odometry.odometry import Odometry
from polarmap.odometry.options import OdometryOptions

_WARM_UP = 60  # frames, which load what is compiled


@dataclass(frozen=True)
class Run:
    """One pass over a video. error: metres. milliseconds: per frame. steps: the same by step."""

    error: float
    milliseconds: float
    steps: dict[str, float]
    tracked: int
    keyframes: int
    segments: int


def main() -> None:
    arguments = _arguments()
    options = OdometryOptions(**dict(item.split("=", 1) for item in arguments.set))
    runs: dict[str, list[Run]] = {}
    frames: dict[str, int] = {}
    for name in arguments.names:
        video = load(arguments.data, name)
        images = list(video.images())
        _odometry(video, images[:_WARM_UP], options, seed=0)
        seeds = track(range(arguments.seeds), f"{name}, {arguments.seeds} seeds", console=Console(stderr=True))
        runs[name] = [_measured(video, images, options, seed) for seed in seeds]
        frames[name] = len(images)
    console = Console(width=120)
    console.print(_accuracy(runs, frames), _steps(runs))


def absolute_trajectory_error(frames: Iterable[PosedFrame], positions: dict[int, np.ndarray]) -> float:
    """Root mean square distance after a similarity alignment, in the truth's unit."""
    pairs = [(f.T_world_camera[:3, 3], positions[f.index]) for f in frames if f.index in positions]
    return trajectory_metrics(*map(np.array, zip(*pairs, strict=True))).similar if len(pairs) > 3 else np.nan


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path, help="folder of the recorded sequences")
    parser.add_argument("names", nargs="*", default=list(VIDEOS), metavar="NAME[/STRIDE]", type=_name)
    parser.add_argument("--seeds", type=int, default=5, help="runs of each, which choose other points")
    parser.add_argument("--set", action="append", default=[], metavar="OPTION=VALUE", help="of polarmap config")
    return parser.parse_args()


def _name(text: str) -> str:
    base, _, stride = text.partition("/")
    if base not in VIDEOS or not re.fullmatch(r"(-?[1-9]\d*)?", stride):
        raise argparse.ArgumentTypeError(f"{text!r} is not one of {', '.join(VIDEOS)}, with /STRIDE or without")
    return text


def _measured(video: Video, images: list, options: OdometryOptions, seed: int) -> Run:
    start = time.perf_counter()
    result = _odometry(video, images, options, seed)
    milliseconds = 1e3 * (time.perf_counter() - start) / len(images)
    main_segment = [frame for frame in result.frames if frame.segment == result.segments[0]]
    return Run(
        absolute_trajectory_error(main_segment, video.positions),
        milliseconds,
        {step: total / len(images) for step, total in result.milliseconds.items()},
        len(main_segment),
        sum(frame.is_keyframe for frame in main_segment),
        len(result.segments),
    )


def _odometry(video: Video, images: list, options: OdometryOptions, seed: int) -> OdometryResult:
    odometry = Odometry(video.camera, options, seed=seed)
    for index, timestamp, image in images:
        odometry.process(image, timestamp, index)
    odometry.finish()
    return odometry.result()


def _accuracy(runs: dict[str, list[Run]], frames: dict[str, int]) -> Table:
    columns = ("frames", "tracked", "keyframes", "segments", "ATE, mm", "ms per frame")
    table = _table("Median over the seeds (least–most)", *columns)
    for name, of_name in runs.items():
        counts = [_spread([getattr(run, key) for run in of_name], 0) for key in ("tracked", "keyframes", "segments")]
        error = _spread([1e3 * run.error for run in of_name], 2)
        table.add_row(name, str(frames[name]), *counts, error, _spread([run.milliseconds for run in of_name], 1))
    return table


def _steps(runs: dict[str, list[Run]]) -> Table:
    steps = list(dict.fromkeys(step for of_name in runs.values() for run in of_name for step in run.steps))
    table = _table("Milliseconds per frame, median", *steps)
    for name, of_name in runs.items():
        table.add_row(name, *(f"{np.median([run.steps.get(step, 0.0) for run in of_name]):.1f}" for step in steps))
    return table


def _table(title: str, *columns: str) -> Table:
    table = Table(title=title, title_justify="left")
    for column in ("", *columns):
        table.add_column(column, justify="right" if column else "left", no_wrap=True)
    return table


def _spread(values: list[float], digits: int) -> str:
    low, middle, high = (f"{value:.{digits}f}" for value in (min(values), np.median(values), max(values)))
    return middle if low == high else f"{middle} ({low}–{high})"


if __name__ == "__main__":
    main()
