"""From Stokes vectors to the raw mosaic of a polarization sensor, with its noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from polarmap.errors import InputError
from polarmap.polarization.types import AngleDirection, SensorLayout, SensorNoise


@dataclass(frozen=True)
class Sensor:
    """A linear sensor with a 2×2 block of polarizers.

    exposure: factor from radiance to S0; an unpolarized S0 = 2 fills the scale, since a polarizer passes half.
    noise: None for a sensor without noise; quantization stays.
    sub_pixel: True, each pixel of a block sees its own point, as on a real sensor; False, all four see the same
        point, and `split` demosaicing is exact.
    seed: of the noise; the same seed and frame index give the same noise.
    """

    layout: SensorLayout = SensorLayout.SONY_POLARSENS
    angle_direction: AngleDirection = AngleDirection.CLOCKWISE
    bit_depth: int = 8
    exposure: float = 1.0
    noise: SensorNoise | None = SensorNoise()  # noqa: RUF009
    sub_pixel: bool = False
    seed: int = 0

    def __post_init__(self) -> None:
        if not 8 <= self.bit_depth <= 16:
            raise InputError(f"sensor: bit_depth must be 8 to 16, not {self.bit_depth}")
        if not (np.isfinite(self.exposure) and self.exposure > 0):
            raise InputError(f"sensor: exposure must be positive, not {self.exposure}")

    def capture(self, stokes: np.ndarray, frame_index: int = 0) -> np.ndarray:
        """The raw mosaic, uint8 (uint16 over 8 bits), of a Stokes image, float32 3×H×W.

        The mosaic is 2H×2W with all four pixels of a block from one Stokes vector; with `sub_pixel` it is H×W, each
        pixel from its own vector, and H and W must be even (InputError where not).
        """
        intensity = self._through_polarizers(stokes) * np.float32(self.exposure)
        return self._quantized(self._noisy(intensity, frame_index))

    def _through_polarizers(self, stokes: np.ndarray) -> np.ndarray:
        """I(α) = ½(S0 + S1 cos 2α + S2 sin 2α) as a mosaic, α that of each pixel's polarizer."""
        height, width = stokes.shape[1:] if self.sub_pixel else (2 * stokes.shape[1], 2 * stokes.shape[2])
        if height % 2 or width % 2:
            raise InputError(f"sensor: a {width}x{height} image does not divide into 2x2 blocks")
        turn = 1.0 if self.angle_direction is AngleDirection.CLOCKWISE else -1.0
        mosaic = np.empty((height, width), np.float32)
        for place, degrees in enumerate(self.layout.value):
            pixels = np.s_[place // 2 :: 2, place % 2 :: 2]
            s0, s1, s2 = stokes[(slice(None), *pixels)] if self.sub_pixel else stokes
            double_angle = 2.0 * turn * np.radians(degrees)
            mosaic[pixels] = 0.5 * (s0 + s1 * np.float32(np.cos(double_angle)) + s2 * np.float32(np.sin(double_angle)))
        return mosaic

    def _noisy(self, intensity: np.ndarray, frame_index: int) -> np.ndarray:
        """Shot noise (Gaussian for its Poisson distribution) and read noise added."""
        if self.noise is None:
            return intensity
        full_well, read_noise = self.noise.full_well, self.noise.read_noise
        sigma = np.sqrt(np.maximum(intensity, 0.0) / full_well + (read_noise / full_well) ** 2, dtype=np.float32)
        rng = np.random.default_rng([self.seed, frame_index])
        return intensity + sigma * rng.standard_normal(intensity.shape, dtype=np.float32)

    def _quantized(self, intensity: np.ndarray) -> np.ndarray:
        white = 2**self.bit_depth - 1
        levels = np.clip(np.rint(intensity * white), 0, white)
        return levels.astype(np.uint8 if self.bit_depth <= 8 else np.uint16)
