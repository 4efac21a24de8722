"""Milliseconds per step of mapping and of odometry, and how they grow with the image.

    python benchmarks/bench_steps.py [--sequence FOLDER --poses FILE] [--repeats 3]

Renders the built-in room at several sizes (or takes a recording as it is), maps it with its true poses after a warm-up,
and prints the median over keyframes and repeats. Keyframes are the same frames at every size. Then odometry tracks the
same frames; its table has the median over repeats. How accurate it is: bench_odometry.py.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table
from rooms import rendered_room

from polarmap.data.keyframe import Keyframe
from polarmap.io.formats.trajectory import read_trajectory
from polarmap.io.recording.sequence import open_sequence
from polarmap.odometry.odometry import Odometry
from polarmap.pipeline.mapper import Mapper
from polarmap.sensing.front_end import FrontEnd

SIZES = ((320, 240), (640, 480), (960, 720), (1224, 1024))
FRAMES = 16


def main() -> None:
    arguments = _arguments()
    console = Console()
    if arguments.sequence:
        recording = open_sequence(arguments.sequence)
        poses = read_trajectory(arguments.poses or arguments.sequence / "groundtruth.txt")
        runs = {"recording": (recording.camera_file, list(recording), poses)}
    else:
        runs = {f"{width}x{height}": rendered_room(width, height, FRAMES) for width, height in SIZES}
    mapping = {name: _measure(*run, arguments.repeats) for name, run in runs.items()}
    odometry = {
        name: _measure_odometry(camera, frames, arguments.repeats) for name, (camera, frames, _) in runs.items()
    }
    for times in (mapping, odometry):
        console.print(_table(times))
        if len(times) > 1:
            console.print(_growth(times))


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sequence", type=Path, help="a recording to time instead of the room")
    parser.add_argument("--poses", type=Path, help="its trajectory (default: its groundtruth.txt)")
    parser.add_argument("--repeats", type=int, default=3)
    return parser.parse_args()


def _measure(camera, frames, poses, repeats: int) -> dict[str, float]:
    """Median milliseconds of each step of a keyframe; "all" is the whole run divided by its keyframes."""
    keyframes: list[Keyframe] = []
    totals = []
    for repeat in range(repeats + 1):
        done: list[Keyframe] = []
        mapper = Mapper(camera, poses, on_keyframe=done.append)
        for frame in frames:
            mapper.process(frame)
        result = mapper.finish()
        if repeat > 0:  # the first one compiles
            keyframes += done
            totals.append(sum(result.milliseconds.values()) / max(result.keyframes, 1))
    steps = {step: float(np.median([k.milliseconds[step] for k in keyframes])) for step in keyframes[0].milliseconds}
    per_frame = ("polarization", "keyframes")
    steps |= {f"{step} (per frame)": result.milliseconds[step] / result.frames for step in per_frame}
    steps["fusion"] = result.milliseconds["fusion"] / result.keyframes
    return steps | {"all, per keyframe": float(np.median(totals))}


def _measure_odometry(camera, frames, repeats: int) -> dict[str, float]:
    """Median milliseconds of odometry's steps; "all" is what a frame takes on average, but for the start."""
    front_end = FrontEnd(camera)
    images = [front_end.grey(frame) for frame in frames]
    runs = [_track(front_end, frames, images) for _ in range(repeats + 1)][1:]  # the first one compiles
    return {step: float(np.median([run[step] for run in runs])) for step in runs[0]}


def _track(front_end: FrontEnd, frames, images) -> dict[str, float]:
    odometry = Odometry(front_end.camera, valid=front_end.valid_grey)
    for frame, image in zip(frames, images, strict=True):
        odometry.process(image, frame.timestamp, frame.index)
    odometry.finish()
    result = odometry.result()
    if not result.frames:
        raise SystemExit(f"odometry could not track the sequence: {result.without_pose[-1][1]}")
    totals = dict(result.milliseconds)
    start = totals.pop("start")
    keyframes = max(sum(frame.is_keyframe for frame in result.frames) - 2, 1)  # those after the start's two
    steps = {f"{step} (per frame)": total / len(images) for step, total in totals.items() if step != "adjust"}
    steps["adjust (per keyframe)"] = totals.get("adjust", 0.0) / keyframes
    return steps | {"start (once)": start, "all, per frame": sum(totals.values()) / len(images)}


def _table(times: dict[str, dict[str, float]]) -> Table:
    table = Table("step, ms", *times)
    for step in next(iter(times.values())):
        table.add_row(step, *(f"{run[step]:.1f}" for run in times.values()))
    return table


def _growth(times: dict[str, dict[str, float]]) -> str:
    """Exponent of the last row's time against pixels by a line through the logarithms: 1 is linear."""
    pixels = [np.log(np.prod([int(n) for n in name.split("x")])) for name in times]
    total = list(next(iter(times.values())))[-1]
    totals = [np.log(run[total]) for run in times.values()]
    return f"time ({total}) grows with pixels to the power {np.polyfit(pixels, totals, 1)[0]:.2f}"


if __name__ == "__main__":
    main()
