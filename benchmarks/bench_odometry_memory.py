"""Memory of the odometry over many frames: a sequence played back and forth without end.

    python benchmarks/bench_odometry_memory.py ../shared/data [NAME] [--frames 5000] [--every 500]

NAME: redwood unless said otherwise; one of the names of `bench_odometry.py`. `resident` is the process's memory after
garbage collection; `more` is what came since the row before. What is kept for good is poses, about half a kilobyte a
frame, and points, 20 bytes each and 400 000 of them at most.
"""

from __future__ import annotations

import argparse
import itertools
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from memory import MEGABYTE, resident
from rich.console import Console
from rich.live import Live
from rich.table import Table
from videos import FRAME_RATE, VIDEOS, load

from polarmap.odometry.odometry import Odometry


def main() -> None:
    arguments = _arguments()
    video = load(arguments.data, arguments.name)
    images = [_packed(image) for _, _, image in video.images()]
    odometry = Odometry(video.camera)
    table = _table(arguments.name)
    before = resident()
    with Live(table, console=Console(width=100), auto_refresh=False) as live:
        for number, image in enumerate(itertools.islice(_back_and_forth(images), arguments.frames), 1):
            odometry.process(image, number / FRAME_RATE, number)
            if number % arguments.every == 0:
                now = resident()
                table.add_row(*_row(odometry, number, now, now - before))
                live.refresh()
                before = now


def _packed(image: np.ndarray) -> np.ndarray:
    return np.round(255 * image).astype(np.uint8)


def _back_and_forth(images: list[np.ndarray]) -> Iterator[np.ndarray]:
    for image in itertools.cycle([*images, *images[-2:0:-1]]):
        yield image.astype(np.float32) / 255


def _table(name: str) -> Table:
    table = Table("frames", "resident MB", "more MB", "posed", "segments", "points", title=f"{name}, back and forth")
    for column in table.columns:
        column.justify = "right"
    return table


def _row(odometry: Odometry, number: int, now: int, more: int) -> list[str]:
    result = odometry.result()
    counts = (len(result.frames), len(result.segments), len(result.points.position))
    return [str(number), f"{now / MEGABYTE:.1f}", f"{more / MEGABYTE:+.1f}", *map(str, counts)]


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", type=Path)
    parser.add_argument("name", nargs="?", default="redwood", help=", ".join(VIDEOS))
    parser.add_argument("--frames", type=int, default=5000)
    parser.add_argument("--every", type=int, default=500)
    return parser.parse_args()


if __name__ == "__main__":
    main()
