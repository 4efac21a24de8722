"""Trajectory error and time of the odometry on recorded sequences.

    python benchmarks/bench_odometry.py ../shared/data [NAME ...] [--seeds 5]

Names: office300, office450, redwood, livingroom. The error is the root mean square distance of all tracked frames'
positions from the truth after a similarity alignment.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from polarmap.evaluation.alignment import umeyama
from polarmap.geometry.camera import PinholeCamera
from polarmap.geometry.pose import from_quaternion
from polarmap.io.sequence import open_sequence
from polarmap.odometry import Odometry, OdometryOptions
from polarmap.polarization.frontend import PolarizationFrontEnd

_MIRROR = np.diag([1.0, -1.0, 1.0, 1.0])  # of ICL-NUIM's y axis


@dataclass(frozen=True)
class Video:
    """Grey images with true positions. images yields (index, timestamp, image)."""

    camera: PinholeCamera
    count: int
    positions: dict[int, np.ndarray]
    images: object


def office(data: Path, first: int, last: int) -> Video:
    folder = data / "icl_office_kt0"
    positions = {}
    for line in (folder / "traj0.gt.freiburg").read_text().splitlines():
        index, *numbers = line.split()
        pose = from_quaternion(np.array(numbers[:3], float), np.array(numbers[3:], float))
        positions[int(index)] = (_MIRROR @ pose @ _MIRROR)[:3, 3]

    def images() -> Iterator:
        for i in range(first, last + 1):
            yield i, i / 30.0, _grey(folder / "gray" / f"{i:04d}.png")

    return Video(PinholeCamera(640, 480, 481.2, 480.0, 319.5, 239.5), last + 1 - first, positions, images)


def redwood(data: Path) -> Video:
    folder = data / "redwood_livingroom1"
    numbers = [line.split() for line in (folder / "trajectory.log").read_text().splitlines() if line.strip()]
    poses = [np.array(numbers[i + 1 : i + 5], float) for i in range(0, len(numbers), 5)]
    files = sorted((folder / "image").glob("*.jpg"))

    def images() -> Iterator:
        for i, path in enumerate(files):
            yield i, i / 30.0, _grey(path)

    positions = {i: pose[:3, 3] for i, pose in enumerate(poses)}
    return Video(PinholeCamera(640, 480, 525.0, 525.0, 319.5, 239.5), len(files), positions, images)


def livingroom(data: Path) -> Video:
    sequence = open_sequence(data / "livingroom")
    front_end = PolarizationFrontEnd(sequence.camera_file)
    truth = sequence.truth_trajectory()
    positions = {f.index: truth.at(f.timestamp)[:3, 3] for f in sequence.files}

    def images() -> Iterator:
        for frame in sequence:
            yield frame.index, frame.timestamp, front_end(frame).intensity

    return Video(front_end.camera, len(sequence), positions, images)


VIDEOS = {
    "office300": lambda data: office(data, 1, 300),
    "office450": lambda data: office(data, 1, 450),
    "redwood": redwood,
    "livingroom": livingroom,
}


def absolute_trajectory_error(frames, positions: dict[int, np.ndarray]) -> float:
    """Root mean square distance after a similarity alignment, in the truth's unit."""
    pairs = [(f.T_world_camera[:3, 3], positions[f.index]) for f in frames if f.index in positions]
    found, true = (np.array(side) for side in zip(*pairs, strict=True))
    aligned = umeyama(found, true)
    error = aligned.scale * found @ aligned.rotation.T + aligned.translation - true
    return float(np.sqrt(np.mean(np.sum(error**2, axis=1))))


def _grey(path: Path) -> np.ndarray:
    return cv2.imread(str(path), cv2.IMREAD_GRAYSCALE).astype(np.float32) / 255.0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", type=Path)
    parser.add_argument("names", nargs="*", default=list(VIDEOS))
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--set", action="append", default=[], help="option=value")
    arguments = parser.parse_args()
    settings = dict(item.split("=") for item in arguments.set)
    for name in arguments.names:
        video = VIDEOS[name](arguments.data)
        images = list(video.images())
        errors, milliseconds = [], []
        for seed in range(arguments.seeds):
            odometry = Odometry(video.camera, OdometryOptions(**settings), seed=seed)
            start = time.perf_counter()
            for index, timestamp, image in images:
                odometry.process(image, timestamp, index)
            odometry.finish()
            milliseconds.append(1e3 * (time.perf_counter() - start) / len(images))
            result = odometry.result()
            main_segment = [f for f in result.frames if f.segment == result.segments[0]] if result.frames else []
            errors.append(absolute_trajectory_error(main_segment, video.positions) if len(main_segment) > 3 else np.nan)
            keyframes = sum(f.is_keyframe for f in main_segment)
            split = " ".join(f"{k} {v / len(images):.1f}" for k, v in result.milliseconds.items())
            print(
                f"{name} seed {seed}: ATE {errors[-1]:.4f} m, {len(main_segment)}/{len(images)} frames, "
                f"{keyframes} keyframes, {len(result.segments)} segments, {milliseconds[-1]:.1f} ms/frame ({split})"
            )
        print(
            f"{name}: median ATE {np.median(errors):.4f} m ({min(errors):.4f}-{max(errors):.4f}), "
            f"{np.median(milliseconds):.1f} ms/frame"
        )


if __name__ == "__main__":
    main()
