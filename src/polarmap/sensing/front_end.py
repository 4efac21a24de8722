"""From a raw frame to intensity, DoLP and AoLP: what is done once to every frame before all else."""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np

from polarmap.data.polarization_image import PolarizationImage
from polarmap.data.sensor import AngleDirection
from polarmap.errors import InputError
from polarmap.geometry.camera import PinholeCamera
from polarmap.geometry.distortion import Undistorter
from polarmap.sensing.mosaic import colour_to_grey, demosaic, noise_gain, reach
from polarmap.sensing.stokes import polarization_image

if TYPE_CHECKING:
    from polarmap.data.camera_file import CameraFile
    from polarmap.data.frame import Frame


def require_polarization(camera_file: CameraFile) -> None:
    """Raise InputError for a camera without polarization."""
    if not camera_file.polarized:
        raise InputError(
            "the sequence has no polarization channels (its camera file says polarization: none); "
            "only odometry works without them"
        )


class PolarizationFrontEnd:
    """Black level and full scale, demosaicing, angle direction, undistortion and Stokes, for one camera.

    `camera` is the undistorted pinhole camera of all that comes out.

    Undistortion moves pixels and keeps what their polarizers measured. That is an approximation: a distorting
    lens also shears directions in the picture, but for the radial and the tangential one. For radial distortion
    of 5 % this changes the angle by at most 3°, there.

    Raises InputError for a camera without polarization.
    """

    def __init__(self, camera_file: CameraFile) -> None:
        require_polarization(camera_file)
        self.camera: PinholeCamera = camera_file.camera
        self._file = camera_file
        distortion = camera_file.distortion
        self._undistorter = Undistorter(self.camera, distortion) if distortion is not None else None

    def __call__(self, frame: Frame) -> PolarizationImage:
        """The frame's polarization image, H×W of `camera`.

        Pixels outside the undistorted view have intensity and DoLP 0 and are `underexposed`. `saturated`
        are those that any clipped raw pixel has a part in. Raises InputError where the frame's size is not
        the camera's.
        """
        file = self._file
        gain = 1.0 if file.layout is None else noise_gain(file.demosaic, file.colour is not None)
        return polarization_image(
            self.channels(frame), file.noise, file.bit_depth, gain, saturated=self._saturated(frame)
        )

    @property
    def valid(self) -> np.ndarray | None:
        """The pixels that the lens shows, bool H×W; None where that is all of them."""
        return None if self._undistorter is None else self._undistorter.valid

    def channels(self, frame: Frame) -> np.ndarray:
        """The four channels, float32 4×H×W in the order 0, 45, 90, 135 degrees clockwise as displayed.

        Shares of full scale, black level taken off, undistorted; NaN outside the view. Raises InputError
        where the frame's size is not the camera's.
        """
        light = self._normalized(self._raw(frame))
        channels = self._in_order(light) if light.ndim == 3 else self._demosaiced(light)
        return channels if self._undistorter is None else self._undistorter(channels)

    def _raw(self, frame: Frame) -> np.ndarray:
        height, width = self.camera.shape
        if self._file.layout is None:
            raw, expected = frame.channels, (4, height, width)
        else:
            raw, expected = frame.mosaic, (2 * height, 2 * width)
        if raw is None or raw.shape != expected:
            found = "no such pixels" if raw is None else f"an array of shape {raw.shape}"
            raise InputError(f"{frame.path}: {found}; the camera file asks for shape {expected}")
        return raw

    def _normalized(self, raw: np.ndarray) -> np.ndarray:
        black = np.float32(self._file.black_level)
        light = raw.astype(np.float32)
        light -= black
        light *= 1 / (np.float32(self._file.white_level) - black)
        return light

    def _in_order(self, channels: np.ndarray) -> np.ndarray:
        clockwise = self._file.angle_direction is AngleDirection.CLOCKWISE
        return channels if clockwise else channels[[0, 3, 2, 1]]

    def _demosaiced(self, mosaic: np.ndarray) -> np.ndarray:
        file = self._file
        grey = mosaic if file.colour is None else colour_to_grey(mosaic)
        return demosaic(grey, file.layout, file.demosaic, file.angle_direction)

    def _saturated(self, frame: Frame) -> np.ndarray:
        """Pixels that a clipped raw pixel has a part in, bool H×W."""
        clipped = self._raw(frame) >= self._file.white_level - 1
        mask = clipped.any(axis=0) if clipped.ndim == 3 else self._clipped_blocks(clipped)
        return mask if self._undistorter is None else self._undistorter.spread(mask)

    def _clipped_blocks(self, clipped: np.ndarray) -> np.ndarray:
        blocks = clipped[::2, ::2] | clipped[::2, 1::2] | clipped[1::2, ::2] | clipped[1::2, 1::2]
        blocks_away = reach(self._file.demosaic, self._file.colour is not None)
        if blocks_away == 0:
            return blocks
        window = np.ones((2 * blocks_away + 1, 2 * blocks_away + 1), np.uint8)
        return cv2.dilate(blocks.view(np.uint8), window).view(np.bool_)
