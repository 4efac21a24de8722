"""Photometric calibration: from pixel values to what falls onto the sensor.

A camera records I(x) = G(t V(x) B(x)): irradiance B, vignette V, exposure time t, response G (Engel, Koltun and
Cremers, "Direct Sparse Odometry", 2016, section 2.1; Engel, Usenko and Cremers, "A Photometrically Calibrated
Benchmark for Monocular Visual Odometry", 2016). Corrected is

    I'(x) = t B(x) = G⁻¹(I(x)) / V(x)

The exposure time stays in it: odometry divides by it where it compares two frames.
"""

from __future__ import annotations

import numpy as np

from polarmap.data.photometric import PhotometricCalibration
from polarmap.errors import InputError
from polarmap.jit import njit


def corrected(image: np.ndarray, calibration: PhotometricCalibration) -> np.ndarray:
    """Irradiance times exposure of an image, float32 H×W in [0, 1].

    image: float32 H×W in [0, 1]; between the table's entries the response is interpolated linearly. White
    stays 1. What would be brighter than that is 1 too, as an ideal camera without vignette would have
    clipped it: a point is then equally bright wherever in the image it is seen. NaN, and pixels of vignette
    0, come out 0. Raises InputError where the image's size is not the vignette's.
    """
    if calibration.vignette is not None and image.shape != calibration.gain.shape:
        found, expected = ("x".join(map(str, shape[::-1])) for shape in (image.shape, calibration.gain.shape))
        raise InputError(f"vignette: the image has {found} pixels, the vignette {expected}")
    return _correct(np.ascontiguousarray(image, np.float32), calibration.table, calibration.gain)


@njit(error_model="numpy")
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
