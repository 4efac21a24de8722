"""What is in a recorded sequence: some of its frames in figures, and pictures of them to look at."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from polarmap.errors import InputError
from polarmap.io.recording.sequence import Sequence
from polarmap.report.frame_pictures import write_pictures
from polarmap.sensing.inspection import FrameInspection, inspect_frames
from polarmap.sensing.mosaic_check import check_mosaic


@dataclass(frozen=True)
class Inspection:
    """A sequence and some of its frames.

    width, height: of the polarization images.
    duration: seconds from the first to the last frame; NaN where the sequence has no times.
    rate: frames per second; NaN for a single frame or without times.
    findings: what in the frames contradicts the camera file, one line each (`check_mosaic`).
    """

    path: str
    frame_count: int
    width: int
    height: int
    bit_depth: int
    demosaic: str
    angle_direction: str
    duration: float
    rate: float
    frames: tuple[FrameInspection, ...]
    findings: tuple[str, ...] = ()


def inspect_sequence(sequence: Sequence, samples: int = 5, pictures_to: Path | None = None) -> Inspection:
    """Look at `samples` frames spread evenly over the sequence, and write their pictures if a folder is given.

    Holds one frame in memory at a time, and the middles of five. Raises InputError for an empty sequence or a frame
    that cannot be read, PolarmapError where a picture cannot be written.
    """
    if len(sequence) == 0:
        raise InputError(f"{sequence.path}: no frames")
    last = len(sequence) - 1
    chosen = sorted({round(i) for i in np.linspace(0, last, min(samples, last + 1))})
    frames = []
    for figures, image in inspect_frames((sequence[i] for i in chosen), sequence.camera_file):
        frames.append(figures)
        if pictures_to is not None:
            write_pictures(pictures_to, figures.name, image, sequence.camera_file.camera)
    findings = check_mosaic((sequence[i].raw for i in chosen), sequence.camera_file)
    return _summary(sequence, tuple(frames), findings)


def _summary(sequence: Sequence, frames: tuple[FrameInspection, ...], findings: tuple[str, ...]) -> Inspection:
    file = sequence.camera_file
    first, last = sequence.timestamps[[0, -1]]
    duration = float(last - first)
    return Inspection(
        path=str(sequence.path),
        frame_count=len(sequence),
        width=file.camera.width,
        height=file.camera.height,
        bit_depth=file.bit_depth,
        demosaic=file.demosaic,
        angle_direction=file.angle_direction.value,
        duration=duration,
        rate=(len(sequence) - 1) / duration if duration > 0 else float("nan"),
        frames=frames,
        findings=findings,
    )
