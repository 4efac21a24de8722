"""From a raw frame to the grey image that odometry works on, and nothing else."""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np

from polarmap.data.photometric import PhotometricCalibration
from polarmap.errors import InputError
from polarmap.geometry.camera import PinholeCamera
from polarmap.geometry.distortion import Undistorter
from polarmap.jit import njit
from polarmap.sensing.photometric import corrected

if TYPE_CHECKING:
    from polarmap.data.camera_file import CameraFile
    from polarmap.data.frame import Frame

_BINOMIAL = np.array([0.25, 0.5, 0.25], np.float32)


class GreyFrontEnd:
    """Black level and full scale, mean of the polarization channels, photometric calibration, undistortion.

    `camera` is the undistorted pinhole camera of the images, `valid` (bool H×W, read-only) the pixels that its
    lens shows. The image of a polarization camera is S0/2: the mean of a 2×2 block of the mosaic, which holds
    each angle once, or of the four pictures. However the camera file demosaics, nothing is interpolated but
    a colour sensor's luminance.
    """

    def __init__(self, camera_file: CameraFile, calibration: PhotometricCalibration | None = None) -> None:
        self.camera: PinholeCamera = camera_file.camera
        self._file = camera_file
        self._calibration = calibration
        distortion = camera_file.distortion
        self._undistorter = Undistorter(self.camera, distortion) if distortion is not None else None
        self.valid = self._visible()
        self.valid.setflags(write=False)

    def __call__(self, frame: Frame) -> np.ndarray:
        """The frame's grey image, float32 H×W in [0, 1], 0 where not `valid`.

        Raises InputError where the frame's size is not the camera's.
        """
        black = np.float32(self._file.black_level)
        scale = np.float32(1) / (np.float32(self._file.white_level) - black)
        grey = self._kernel(self._raw(frame), black, scale)
        if self._file.colour is not None:
            # R/4 + G/2 + B/4 of any Bayer pattern, as `mosaic.colour_to_grey` makes of each angle.
            grey = cv2.sepFilter2D(grey, -1, _BINOMIAL, _BINOMIAL, borderType=cv2.BORDER_REFLECT_101)
        if self._calibration is not None:
            grey = corrected(grey, self._calibration)
        return grey if self._undistorter is None else self._undistorter.image(grey)

    def _visible(self) -> np.ndarray:
        vignette = None if self._calibration is None else self._calibration.vignette
        dark = np.zeros(self.camera.shape, np.bool_) if vignette is None else np.asarray(vignette) <= 0
        if self._undistorter is None:
            return ~dark
        return self._undistorter.valid & ~self._undistorter.spread(dark)

    def _kernel(self, raw: np.ndarray, black: np.float32, scale: np.float32) -> np.ndarray:
        if not self._file.polarized:
            return _scaled(raw, black, scale)
        return _mean_of_pictures(raw, black, scale) if raw.ndim == 3 else _mean_of_blocks(raw, black, scale)

    def _raw(self, frame: Frame) -> np.ndarray:
        height, width = self.camera.shape
        if not self._file.polarized:
            raw, expected = frame.grey, (height, width)
        elif self._file.layout is None:
            raw, expected = frame.channels, (4, height, width)
        else:
            raw, expected = frame.mosaic, (2 * height, 2 * width)
        if raw is None or raw.shape != expected:
            found = "no such pixels" if raw is None else f"an array of shape {raw.shape}"
            raise InputError(f"{frame.path}: {found}; the camera file asks for shape {expected}")
        return np.ascontiguousarray(raw)


@njit
def _scaled(picture, black, scale):
    height, width = picture.shape
    out = np.empty((height, width), np.float32)
    for y in range(height):
        for x in range(width):
            out[y, x] = max((np.float32(picture[y, x]) - black) * scale, np.float32(0))
    return out


@njit
def _mean_of_blocks(mosaic, black, scale):
    height, width = mosaic.shape[0] // 2, mosaic.shape[1] // 2
    quarter = np.float32(0.25)
    out = np.empty((height, width), np.float32)
    for y in range(height):
        upper, lower = mosaic[2 * y], mosaic[2 * y + 1]
        for x in range(width):
            total = np.int32(upper[2 * x]) + np.int32(upper[2 * x + 1])
            total += np.int32(lower[2 * x]) + np.int32(lower[2 * x + 1])
            out[y, x] = max((quarter * np.float32(total) - black) * scale, np.float32(0))
    return out


@njit
def _mean_of_pictures(pictures, black, scale):
    _, height, width = pictures.shape
    quarter = np.float32(0.25)
    out = np.empty((height, width), np.float32)
    for y in range(height):
        for x in range(width):
            total = np.int32(pictures[0, y, x]) + np.int32(pictures[1, y, x])
            total += np.int32(pictures[2, y, x]) + np.int32(pictures[3, y, x])
            out[y, x] = max((quarter * np.float32(total) - black) * scale, np.float32(0))
    return out
