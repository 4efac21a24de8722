"""Milliseconds per step and keyframe, and how they grow with the image.

    python benchmarks/bench_steps.py [--sequence FOLDER --poses FILE] [--repeats 3]

Renders the built-in room at several sizes (or takes a recording as it is), maps it after a warm-up, and prints the
median over keyframes and repeats. Keyframes are the same frames at every size.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from polarmap.geometry.camera import PinholeCamera
from polarmap.io.sequence import Frame, open_sequence
from polarmap.io.trajectory import Trajectory, read_trajectory
from polarmap.mapper import Mapper
from polarmap.results import Keyframe
from polarmap.synth.recording import camera_file
from polarmap.synth.scenes import built_in_scene
from polarmap.synth.sensor import Sensor
from polarmap.synth.sequence import render_sequence

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
        runs = {f"{width}x{height}": _rendered(width, height) for width, height in SIZES}
    times = {name: _measure(*run, arguments.repeats) for name, run in runs.items()}
    console.print(_table(times))
    if len(times) > 1:
        console.print(_growth(times))


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sequence", type=Path, help="a recording to time instead of the room")
    parser.add_argument("--poses", type=Path, help="its trajectory (default: its groundtruth.txt)")
    parser.add_argument("--repeats", type=int, default=3)
    return parser.parse_args()


def _rendered(width: int, height: int):
    focal = 0.75 * width
    camera = PinholeCamera(width, height, focal, focal, (width - 1) / 2, (height - 1) / 2)
    scene = built_in_scene("room")
    timestamps, poses = scene.path(FRAMES)
    sensor = Sensor()
    frames = [
        Frame(f.index, f.timestamp, f"{f.index:06d}", Path(f"{f.index:06d}"), mosaic=f.mosaic)
        for f in render_sequence(scene.scene, camera, timestamps, poses, sensor, supersample=1)
    ]
    return camera_file(camera, sensor), frames, Trajectory(timestamps, poses)


def _measure(camera, frames, poses, repeats: int) -> dict[str, float]:
    """Median milliseconds of each step of a keyframe; "all" is the whole run divided by its keyframes."""
    keyframes: list[Keyframe] = []
    totals = []
    for repeat in range(repeats + 1):
        done: list[Keyframe] = []
        mapper = Mapper(camera, poses.at, on_keyframe=done.append)
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


def _table(times: dict[str, dict[str, float]]) -> Table:
    table = Table("step, ms", *times)
    for step in next(iter(times.values())):
        table.add_row(step, *(f"{run[step]:.1f}" for run in times.values()))
    return table


def _growth(times: dict[str, dict[str, float]]) -> str:
    """Exponent of time against pixels by a line through the logarithms: 1 is linear."""
    pixels = [np.log(np.prod([int(n) for n in name.split("x")])) for name in times]
    totals = [np.log(run["all, per keyframe"]) for run in times.values()]
    return f"time grows with pixels to the power {np.polyfit(pixels, totals, 1)[0]:.2f}"


if __name__ == "__main__":
    main()
