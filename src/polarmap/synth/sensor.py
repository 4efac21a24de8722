"""From Stokes vectors to the raw mosaic of a polarization sensor, with its noise."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from polarmap.data.sensor import AngleDirection, SensorLayout, SensorNoise
from polarmap.errors import InputError

_LARGEST_EXPOSURE = 1e12  # so that float32 holds the products


@dataclass(frozen=True)
class Sensor:
    """A linear sensor with a 2×2 block of polarizers.

    exposure: factor from radiance to S0; an unpolarized S0 = 2 fills the scale, since a polarizer passes half.
    noise: None for a sensor without noise; quantization stays.
    sub_pixel: True, each pixel of a block sees its own point, as on a real sensor; False, all four see the same
        point, and `split` demosaicing is exact.
    extinction_ratio: a polarizer passes its own direction by 1 and the crossed one by 1/extinction_ratio; over 1,
        infinite for an ideal one. Polarization then looks weaker by (1 - 1/ratio)/(1 + 1/ratio).
    shutter: share of the interval between frames during which light is collected, in [0, 1], centred on the frame's
        time; 0 for no motion blur. Whoever renders averages over it (`polarmap.synth.shutter`), not `capture`.
    seed: of the noise; the same seed and frame index give the same noise.
    Raises InputError where a value is out of range.
    """

    layout: SensorLayout = SensorLayout.SONY_POLARSENS
    angle_direction: AngleDirection = AngleDirection.CLOCKWISE
    bit_depth: int = 8
    exposure: float = 1.0
    noise: SensorNoise | None = SensorNoise()  # noqa: RUF009
    sub_pixel: bool = False
    extinction_ratio: float = math.inf
    shutter: float = 0.0
    seed: int = 0

    def __post_init__(self) -> None:
        if not 8 <= self.bit_depth <= 16:
            raise InputError(f"sensor: bit_depth must be 8 to 16, not {self.bit_depth}")
        if not 0 < self.exposure <= _LARGEST_EXPOSURE:
            raise InputError(f"sensor: exposure must be positive, at most {_LARGEST_EXPOSURE:g}, not {self.exposure}")
        if not self.extinction_ratio > 1:
            raise InputError(f"sensor: extinction_ratio must be over 1, not {self.extinction_ratio}")
        if not 0 <= self.shutter <= 1:
            raise InputError(f"sensor: shutter must be in [0, 1], not {self.shutter}")
        if self.seed < 0:
            raise InputError(f"sensor: seed must be 0 or more, not {self.seed}")
        if self.noise is not None:
            self.noise.check("sensor")

    def capture(self, stokes: np.ndarray, frame_index: int = 0) -> np.ndarray:
        """The raw mosaic, uint8 (uint16 over 8 bits), of a Stokes image, float32 3×H×W.

        The mosaic is 2H×2W with all four pixels of a block from one Stokes vector; with `sub_pixel` it is H×W, each
        pixel from its own vector, and H and W must be even (InputError where not).
        """
        intensity = self._through_polarizers(stokes) * np.float32(self.exposure)
        return self._quantized(self._noisy(intensity, frame_index))

    def _through_polarizers(self, stokes: np.ndarray) -> np.ndarray:
        """I(α) = ½((1+ε) S0 + (1-ε)(S1 cos 2α + S2 sin 2α)) as a mosaic, α each pixel's angle, ε what leaks."""
        height, width = stokes.shape[1:] if self.sub_pixel else (2 * stokes.shape[1], 2 * stokes.shape[2])
        if height % 2 or width % 2:
            raise InputError(f"sensor: a {width}x{height} image does not divide into 2x2 blocks")
        turn = 1.0 if self.angle_direction is AngleDirection.CLOCKWISE else -1.0
        leak = 1.0 / self.extinction_ratio
        mosaic = np.empty((height, width), np.float32)
        for place, degrees in enumerate(self.layout.value):
            pixels = np.s_[place // 2 :: 2, place % 2 :: 2]
            s0, s1, s2 = stokes[(slice(None), *pixels)] if self.sub_pixel else stokes
            double_angle = 2.0 * turn * np.radians(degrees)
            cosine, sine = np.float32(np.cos(double_angle)), np.float32(np.sin(double_angle))
            mosaic[pixels] = 0.5 * ((1.0 + leak) * s0 + (1.0 - leak) * (s1 * cosine + s2 * sine))
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
