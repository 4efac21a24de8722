"""Memory of a live run over many frames: the built-in room played forth and back without end.

    python benchmarks/bench_live_memory.py [--frames 10000] [--every 500] [--rate 30] [--sequence FOLDER]

Renders 60 frames of 320x240 (or takes a recording) and maps them by odometry as `polarmap run --realtime` does. Without
--rate each frame comes as soon as the one before has its pose; with it frames come at so many a second, and are lost
while too many wait. `resident` is the process's memory after garbage collection; `more` is what came since the row
before. The slope is that of a line through the second half of the rows.

What is kept for good: each frame's pose, about half a kilobyte; points of odometry, 20 bytes each and 400 000 at most;
each keyframe's line of results.json; and the surface, which grows a little as far as odometry, which closes no loops,
drifts. The C library keeps what was freed for threads that may want it again, so that rows go up and
down by some megabytes: with MALLOC_ARENA_MAX=1 MALLOC_MMAP_THRESHOLD_=65536 in the environment it gives it back.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter

import numpy as np
from memory import MEGABYTE, resident
from rich.console import Console
from rich.live import Live
from rich.table import Table
from rooms import FRAME_RATE, forth_and_back, recorded_room

from polarmap.data.codes import Status
from polarmap.data.frame import Frame
from polarmap.io.recording.replay import Replay
from polarmap.io.recording.sequence import Sequence, open_sequence
from polarmap.pipeline.config import Config
from polarmap.pipeline.poses.found import odometry_poses
from polarmap.report.run_writer import RunWriter
from polarmap.run import run_live
from polarmap.warm_up import warm_up

SIZE = 320, 240
RENDERED = 60
STEP = 0.015  # metres from frame to frame


class Unpaced(Replay):
    """Frames that come as soon as they are asked for. `when` knows of the last one only, so that latencies are void."""

    def __iter__(self) -> Iterator[Frame]:
        self.begun = perf_counter()
        for frame in self._sequence:
            self.exposed = perf_counter()
            yield frame

    def when(self, timestamp: float) -> float:
        return self.exposed


class MemoryLog:
    """A row for every so many frames of a run; called after each frame."""

    def __init__(self, every: int, show: Live, table: Table) -> None:
        self.frames: list[int] = []
        self.megabytes = [resident() / MEGABYTE]  # before the first frame, too
        self._every, self._show, self._table = every, show, table
        self._count = self._posed = 0

    def __call__(self, keyframes: int, status: Status) -> None:
        self._count += 1
        self._posed += status is Status.TRACKED
        if self._count % self._every:
            return
        now = resident() / MEGABYTE
        more = now - self.megabytes[-1]
        self._table.add_row(str(self._count), f"{now:.1f}", f"{more:+.1f}", str(self._posed), str(keyframes))
        self._show.refresh()
        self.frames.append(self._count)
        self.megabytes.append(now)

    def slope(self) -> str:
        """Of memory against frames over the second half."""
        half = len(self.frames) // 2
        frames, megabytes = self.frames[half:], self.megabytes[1:][half:]
        if len(frames) < 2:
            return "too few rows for a slope"
        per_frame = np.polyfit(frames, megabytes, 1)[0]
        return f"{1000 * per_frame:+.2f} MB per 1000 frames, from frame {frames[0]} to {frames[-1]}"


def main() -> None:
    arguments = _arguments()
    console = Console(width=100)
    warm_up()
    with _recording(arguments.sequence) as recording, TemporaryDirectory() as out:
        played = forth_and_back(recording, arguments.frames, arguments.rate or FRAME_RATE)
        replay = Replay(played) if arguments.rate else Unpaced(played)
        poses = odometry_poses(played.camera_file, side_by_side=True)
        writer = RunWriter(Path(out) / "run", Config(), played.camera_file.camera, poses="odometry")
        table = Table("frames", "resident MB", "more MB", "posed", "keyframes", title="live run, forth and back")
        for column in table.columns:
            column.justify = "right"
        with Live(table, console=console, auto_refresh=False) as show:
            log = MemoryLog(arguments.every, show, table)
            result = run_live(replay, poses, writer, on_frame=log)
        console.print()
        console.print(log.slope())
        console.print(f"frames missed: {replay.missed}; segments: {1 + len(result.others)}; blocks: {result.blocks}")


@contextmanager
def _recording(folder: Path | None) -> Iterator[Sequence]:
    if folder:
        yield open_sequence(folder)
        return
    with TemporaryDirectory() as rendered:
        yield recorded_room(Path(rendered) / "room", *SIZE, RENDERED, STEP)


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sequence", type=Path, help="a recording to play instead of the room")
    parser.add_argument("--frames", type=int, default=10_000)
    parser.add_argument("--every", type=int, default=500, help="frames from row to row")
    parser.add_argument("--rate", type=float, help="frames a second (default: as many as can be)")
    return parser.parse_args()


if __name__ == "__main__":
    main()
