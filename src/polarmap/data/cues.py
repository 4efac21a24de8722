"""Polarization whose ambiguities are resolved."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from polarmap.geometry.camera import PinholeCamera
from polarmap.geometry.surface import normals_from_cues


@dataclass(frozen=True)
class Cues:
    """Disambiguated polarization, H×W each, NaN (label 0, confidence 0) where it says nothing.

    azimuth: float32 radians in (-π, π]. zenith: float32 radians in [0, π/2].
    label: uint8, a `Reflection`. confidence: float32 in [0, 1], how clear the angle and the vote are.
    """

    azimuth: np.ndarray
    zenith: np.ndarray
    label: np.ndarray
    confidence: np.ndarray

    def normals(self, camera: PinholeCamera, orthographic: bool = False) -> np.ndarray:
        """The normals that the cues state, float32 H×W×3."""
        return normals_from_cues(self.azimuth, self.zenith, camera, orthographic)
