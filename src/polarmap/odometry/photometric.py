"""Photometric calibration: from pixel values to what falls onto the sensor.

A camera records I(x) = G(t V(x) B(x)): irradiance B, vignette V, exposure time t, response G (Engel, Koltun and
Cremers, "Direct Sparse Odometry", 2016, section 2.1; Engel, Usenko and Cremers, "A Photometrically Calibrated
Benchmark for Monocular Visual Odometry", 2016). Corrected is

    I'(x) = t B(x) = G⁻¹(I(x)) / V(x)

The exposure time stays in it: odometry divides by it where it compares two frames.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from polarmap.errors import InputError
from polarmap.jit import njit

_LEAST_ENTRIES = 256
_IDENTITY = np.array([0.0, 1.0], np.float32)


@dataclass(frozen=True, eq=False)
class PhotometricCalibration:
    """Response and vignette of a camera, black level taken off, values as shares of full scale.

    inverse_response: G⁻¹ at equidistant pixel values from 0 to 1, float32 N, N at least 256, strictly increasing
        from 0 to 1; None for a linear camera.
    vignette: V, float32 H×W in [0, 1], 1 where the lens lets most through, 0 where nothing; None for none.
    Raises InputError where they are otherwise.
    """

    inverse_response: np.ndarray | None = None
    vignette: np.ndarray | None = None
    _table: np.ndarray = field(init=False, repr=False)
    _gain: np.ndarray = field(init=False, repr=False)

    def __post_init__(self) -> None:
        if self.inverse_response is not None:
            _check_response(np.asarray(self.inverse_response))
        if self.vignette is not None:
            _check_vignette(np.asarray(self.vignette))
        table = _IDENTITY if self.inverse_response is None else np.array(self.inverse_response, np.float32)
        object.__setattr__(self, "_table", table)
        object.__setattr__(self, "_gain", _gain(self.vignette))

    def correct(self, image: np.ndarray) -> np.ndarray:
        """Irradiance times exposure of an image, float32 H×W in [0, 1].

        image: float32 H×W in [0, 1]; between the table's entries the response is interpolated linearly. White
        stays 1. What would be brighter than that is 1 too, as an ideal camera without vignette would have
        clipped it: a point is then equally bright wherever in the image it is seen. NaN, and pixels of vignette
        0, come out 0. Raises InputError where the image's size is not the vignette's.
        """
        if self.vignette is not None and image.shape != self._gain.shape:
            found, expected = ("x".join(map(str, shape[::-1])) for shape in (image.shape, self._gain.shape))
            raise InputError(f"vignette: the image has {found} pixels, the vignette {expected}")
        return _correct(np.ascontiguousarray(image, np.float32), self._table, self._gain)


def _check_response(table: np.ndarray) -> None:
    if table.ndim != 1 or len(table) < _LEAST_ENTRIES:
        raise InputError(f"response: {table.size} values, expected {_LEAST_ENTRIES} or more in one row")
    if not np.isfinite(table).all() or table[0] != 0 or table[-1] != 1:
        raise InputError("response: the values must go from 0 to 1")
    if (np.diff(table.astype(np.float32)) <= 0).any():
        raise InputError("response: the values must increase from each to the next")


def _check_vignette(vignette: np.ndarray) -> None:
    if vignette.ndim != 2 or vignette.size == 0:
        raise InputError("vignette: not an image of one channel")
    if not (vignette.min() >= 0 and 0 < vignette.max() <= 1):
        raise InputError("vignette: the values must be in [0, 1], and not all 0")


def _gain(vignette: np.ndarray | None) -> np.ndarray:
    """1/V, 0 where V is 0, float32 H×W; 0×0 for none."""
    if vignette is None:
        return np.empty((0, 0), np.float32)
    vignette = np.array(vignette, np.float32)
    return np.divide(1, vignette, out=np.zeros_like(vignette), where=vignette > 0)


@njit(nogil=True, error_model="numpy")
def _correct(image, table, gain):
    height, width = image.shape
    last, vignetted = len(table) - 1, gain.size > 0
    zero, one = np.float32(0), np.float32(1)
    out = np.empty((height, width), np.float32)
    for y in range(height):
        for x in range(width):
            # Comparisons with NaN are false, so that it ends as 0 and never as an index.
            value = image[y, x] if image[y, x] > zero else zero
            position = (value if value < one else one) * np.float32(last)
            entry = min(np.int32(position), last - 1)
            value = table[entry] + (position - np.float32(entry)) * (table[entry + 1] - table[entry])
            if vignetted:
                value *= gain[y, x]
            out[y, x] = value if value < one else one
    return out
