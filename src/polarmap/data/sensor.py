"""What a polarization sensor is: the layout of its polarizers, which way their angles turn, its noise."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np

from polarmap.errors import InputError

LARGEST_FULL_WELL = 1e12  # electrons
LARGEST_READ_NOISE = 1e6  # electrons rms


class SensorLayout(Enum):
    """Polarizer angles of a 2×2 block in degrees, row by row, as the sensor labels them."""

    SONY_POLARSENS = (90, 45, 135, 0)
    LAYOUT_0_45_135_90 = (0, 45, 135, 90)
    LAYOUT_45_0_90_135 = (45, 0, 90, 135)
    LAYOUT_135_90_0_45 = (135, 90, 0, 45)
    LAYOUT_90_135_45_0 = (90, 135, 45, 0)
    LAYOUT_0_135_45_90 = (0, 135, 45, 90)
    LAYOUT_135_0_90_45 = (135, 0, 90, 45)
    LAYOUT_45_90_0_135 = (45, 90, 0, 135)

    @classmethod
    def from_angles(cls, angles: object) -> SensorLayout:
        """The layout with these four angles; InputError where there is none."""
        try:
            return cls(tuple(int(a) for a in np.asarray(angles).ravel()))
        except (ValueError, TypeError):
            known = ", ".join(str(list(layout.value)) for layout in cls)
            raise InputError(
                f"mosaic: {angles!r} is not a polarizer layout; write the block row by row, in which the angles across "
                f"a diagonal are 90 degrees apart: {known}"
            ) from None


class AngleDirection(Enum):
    """Which way the labelled polarizer angles turn, as the image is displayed."""

    CLOCKWISE = "clockwise"  # from +x toward +y, this project's own convention
    COUNTERCLOCKWISE = "counterclockwise"


@dataclass(frozen=True)
class SensorNoise:
    """Shot and read noise of a linear sensor, both for intensities as a share of full scale.

    The variance of an intensity I is I/full_well + (read_noise/full_well)² + the quantization step²/12.
    """

    full_well: float = 10_000.0  # electrons at full scale
    read_noise: float = 2.5  # electrons rms

    def check(self, where: str) -> None:
        """Raise InputError where a number is out of the range in which variances are finite."""
        if not self.full_well > 0:
            raise InputError(f"{where}: full_well is not positive, but {self.full_well}")
        if not 1.0 <= self.full_well <= LARGEST_FULL_WELL:
            raise InputError(f"{where}: full_well must be 1 to {LARGEST_FULL_WELL:g} electrons, not {self.full_well}")
        if not 0.0 <= self.read_noise <= LARGEST_READ_NOISE:
            raise InputError(
                f"{where}: read_noise must be 0 to {LARGEST_READ_NOISE:g} electrons, not {self.read_noise}"
            )

    def variance(self, intensity: np.ndarray, bit_depth: int = 16) -> np.ndarray:
        """Variance of intensities in [0, 1], same shape, float32."""
        step = 1.0 / (2**bit_depth - 1)
        floor = (self.read_noise / self.full_well) ** 2 + step**2 / 12.0
        return np.maximum(intensity, 0.0).astype(np.float32) / np.float32(self.full_well) + np.float32(floor)
