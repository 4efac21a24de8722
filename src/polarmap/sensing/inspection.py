"""What single frames hold, in figures: exposure, polarization, and how far noise lets it be known."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from polarmap.data.polarization_image import PolarizationImage
from polarmap.sensing.front_end import FrontEnd

if TYPE_CHECKING:
    from polarmap.data.camera_file import CameraFile
    from polarmap.data.frame import Frame

POLARIZED = 0.05
"""DoLP from which an angle tells something about a surface."""


@dataclass(frozen=True)
class FrameInspection:
    """One frame. Shares are of its pixels; NaN where no pixel counts.

    lowest, highest: raw pixel values.
    saturated, underexposed: shares clipped at the top, and too dark.
    dolp: median degree of linear polarization.
    polarized: share with a DoLP above 0.05.
    residual: median of |(I0 + I90) - (I45 + I135)| / S0.
    sigma_aolp, sigma_aolp_polarized: median standard deviation of the angle, degrees, of all pixels and of
        those with a DoLP above 0.05.
    """

    index: int
    name: str
    timestamp: float
    lowest: int
    highest: int
    saturated: float
    underexposed: float
    dolp: float
    polarized: float
    residual: float
    sigma_aolp: float
    sigma_aolp_polarized: float


def inspect_frames(
    frames: Iterable[Frame], camera_file: CameraFile
) -> Iterator[tuple[FrameInspection, PolarizationImage]]:
    """The figures of each frame and its polarization image, one frame in memory at a time.

    Raises InputError for a camera without polarization, or where a frame's size is not the camera's.
    """
    front_end = FrontEnd(camera_file)
    for frame in frames:
        image = front_end.polarization(frame)
        yield _inspect(frame, image, front_end.consistency(frame)), image


def _inspect(frame: Frame, image: PolarizationImage, residual: np.ndarray) -> FrameInspection:
    polarized = image.dolp > POLARIZED
    return FrameInspection(
        index=frame.index,
        name=frame.name,
        timestamp=frame.timestamp,
        lowest=int(frame.raw.min()),
        highest=int(frame.raw.max()),
        saturated=float(image.saturated.mean()),
        underexposed=float(image.underexposed.mean()),
        dolp=_median(image.dolp),
        polarized=float(polarized.mean()),
        residual=_median(residual),
        sigma_aolp=float(np.degrees(_median(image.sigma_aolp))),
        sigma_aolp_polarized=float(np.degrees(_median(image.sigma_aolp[polarized]))),
    )


def _median(values: np.ndarray) -> float:
    finite = values[np.isfinite(values)]
    return float(np.median(finite)) if finite.size else float("nan")
