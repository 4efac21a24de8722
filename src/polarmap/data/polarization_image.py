"""Intensity, degree and angle of polarization of a frame."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np


@dataclass(frozen=True)
class PolarizationImage:
    """Grey image, degree and angle of linear polarization of one frame, all H×W.

    intensity: S0/2, the mean of the four channels, float32, 1 at full scale.
    dolp: degree of linear polarization ρ, float32; may exceed 1 by noise; 0 where intensity is 0.
    aolp: angle of linear polarization φ, float32 radians in [0, π), from image +x toward +y.
    sigma_dolp, sigma_aolp: standard deviations by propagated sensor noise, float32; sigma_dolp is at most
        1, sigma_aolp at most π/sqrt(12), that of an angle of which nothing is known.
    saturated, underexposed: bool; a channel clipped at the top, or so dark that noise rules.
    """

    intensity: np.ndarray
    dolp: np.ndarray
    aolp: np.ndarray
    sigma_dolp: np.ndarray
    sigma_aolp: np.ndarray
    saturated: np.ndarray
    underexposed: np.ndarray

    @classmethod
    def unpolarized(cls, intensity: np.ndarray) -> PolarizationImage:
        """A grey image, float32 H×W linear, as one of unpolarized light whose angle nothing is known of."""
        nothing, none = np.zeros(intensity.shape, np.float32), np.zeros(intensity.shape, bool)
        unknown = np.full(intensity.shape, np.pi / np.sqrt(12.0), np.float32)
        return cls(intensity, nothing, nothing, np.ones(intensity.shape, np.float32), unknown, none, none)

    @cached_property
    def stable(self) -> np.ndarray:
        """√intensity, float32 H×W, as `stabilized`; made when it is first asked for."""
        return stabilized(self.intensity)

    @cached_property
    def components(self) -> tuple[np.ndarray, np.ndarray]:
        """S1/S0 and S2/S0, float32 H×W each; made when they are first asked for."""
        double = np.float32(2.0) * self.aolp
        return self.dolp * np.cos(double), self.dolp * np.sin(double)

    @cached_property
    def usable(self) -> np.ndarray:
        """Pixels whose polarization means something: neither clipped nor dark, and 0 <= ρ <= 1."""
        return ~self.saturated & ~self.underexposed & (self.dolp <= 1.0)


def stabilized(intensity: np.ndarray) -> np.ndarray:
    """Square root of the intensity, float32: shot noise becomes equally strong everywhere (Anscombe 1948)."""
    return np.sqrt(np.maximum(intensity, 0.0)).astype(np.float32)
