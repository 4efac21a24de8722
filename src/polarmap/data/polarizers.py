"""What the polarizers of a sensor really are: their angles, and what their pixels make of light."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from polarmap.data.sensor import AngleDirection
from polarmap.errors import InputError

LABELS = (0, 45, 90, 135)
"""Degrees that the four channels are labelled with, in the order of everything here."""

_FARTHEST = 20.0  # degrees that an angle may be from its label
_GAINS = (0.2, 5.0)
_EFFICIENCIES = (0.1, 1.05)  # above 1 by errors of measurement alone


@dataclass(frozen=True)
class PolarizerCalibration:
    """The four channels labelled 0, 45, 90 and 135 degrees, in this order: I = g/2 (S0 + e (S1 cos 2φ + S2 sin 2φ)).

    angles: φ in degrees, turning as the labels do. gains: g, relative, 1 on average. efficiencies: e, the degree of
    polarization that is seen of fully polarized light; (r - 1)/(r + 1) for an extinction ratio r.
    Raises InputError where one is out of range.
    """

    angles: tuple[float, float, float, float]
    gains: tuple[float, float, float, float] = (1.0, 1.0, 1.0, 1.0)
    efficiencies: tuple[float, float, float, float] = (1.0, 1.0, 1.0, 1.0)

    def __post_init__(self) -> None:
        for name in ("angles", "gains", "efficiencies"):
            values = getattr(self, name)
            if len(values) != 4 or not all(math.isfinite(value) for value in values):
                raise InputError(f"calibration.{name}: not four finite numbers, of the channels 0, 45, 90 and 135")
        for label, angle in zip(LABELS, self.angles, strict=True):
            if abs((angle - label + 90.0) % 180.0 - 90.0) > _FARTHEST:
                raise InputError(
                    f"calibration.angles: {angle:.5g} is more than {_FARTHEST:g} degrees from {label}; their order "
                    "is that of the channels labelled 0, 45, 90 and 135"
                )
        self._check_range("gains", *_GAINS)
        self._check_range("efficiencies", *_EFFICIENCIES)

    def _check_range(self, name: str, least: float, most: float) -> None:
        for value in getattr(self, name):
            if not least <= value <= most:
                raise InputError(f"calibration.{name}: {value:.5g} is not in [{least:g}, {most:g}]")

    def measurement_matrix(self, direction: AngleDirection) -> np.ndarray:
        """What the channels measure of (S0, S1, S2), float64 4×3.

        Rows are in the order 0, 45, 90, 135 degrees clockwise as displayed, whichever way the labels turn.
        """
        sign, order = (1.0, [0, 1, 2, 3]) if direction is AngleDirection.CLOCKWISE else (-1.0, [0, 3, 2, 1])
        double = np.radians(2.0 * sign * np.asarray(self.angles, np.float64))
        gains, efficiencies = np.asarray(self.gains, np.float64), np.asarray(self.efficiencies, np.float64)
        rows = np.stack([np.ones(4), efficiencies * np.cos(double), efficiencies * np.sin(double)], axis=1)
        return (0.5 * gains[:, None] * rows)[order]
