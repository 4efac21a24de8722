"""From a raw frame to intensity, DoLP and AoLP, and to the grey image of odometry: each when it is asked for."""

from __future__ import annotations

from functools import cached_property

import cv2
import numpy as np

from polarmap.data.camera_file import CameraFile
from polarmap.data.frame import Frame
from polarmap.data.photometric import PhotometricCalibration
from polarmap.data.polarization_image import PolarizationImage
from polarmap.data.sensor import AngleDirection
from polarmap.errors import InputError
from polarmap.geometry.camera import PinholeCamera
from polarmap.geometry.distortion import Undistorter
from polarmap.sensing.calibrated import CalibratedStokes
from polarmap.sensing.grey import mean_of_blocks, mean_of_pictures, scaled
from polarmap.sensing.mosaic import (
    colour_to_grey,
    demosaic,
    mean_of_split_light,
    noise_gain,
    reach,
    split_light,
)
from polarmap.sensing.photometric import corrected
from polarmap.sensing.stokes import consistency_residual, mean_intensity, polarization_image

_BINOMIAL = np.array([0.25, 0.5, 0.25], np.float32)


class SensedFrame:
    """A frame and what can be seen in it; each image is made when it is first asked for, and kept.

    index, timestamp (seconds), exposure (seconds, NaN if not known): the frame's.
    """

    def __init__(self, front_end: FrontEnd, frame: Frame) -> None:
        self.index, self.timestamp, self.exposure = frame.index, frame.timestamp, frame.exposure
        self._front_end = front_end
        self._frame = frame

    @cached_property
    def intensity(self) -> np.ndarray:
        """As `FrontEnd.intensity`."""
        return self._front_end.intensity(self._frame)

    @cached_property
    def polarization(self) -> PolarizationImage:
        """As `FrontEnd.polarization`."""
        return self._front_end.polarization(self._frame)

    @cached_property
    def grey(self) -> np.ndarray:
        """As `FrontEnd.grey`."""
        return self._front_end.grey(self._frame)


class GivenImage(SensedFrame):
    """A polarization image that somebody else has made, in place of a frame; odometry sees its intensity."""

    def __init__(self, image: PolarizationImage, timestamp: float, index: int, exposure: float | None = None) -> None:
        self.index, self.timestamp = index, timestamp
        self.exposure = float("nan") if exposure is None else exposure
        self.polarization = image
        self.intensity = self.grey = image.intensity


class FrontEnd:
    """Black level and full scale, demosaicing, angle direction, undistortion and Stokes, for one camera.

    Stokes parameters are those of ideal polarizers, or where the camera file has a `calibration`, of the measured ones.

    camera: the undistorted pinhole camera of all that comes out. calibration: photometric, of the grey image.

    Undistortion moves pixels and keeps what their polarizers measured. That is an approximation: a distorting
    lens also shears directions in the picture, but for the radial and the tangential one. For radial distortion
    of 5 % this changes the angle by at most 3°, there.
    """

    def __init__(self, camera_file: CameraFile, calibration: PhotometricCalibration | None = None) -> None:
        self.camera: PinholeCamera = camera_file.camera
        self._file = camera_file
        self._calibration = calibration
        distortion = camera_file.distortion
        self._undistorter = Undistorter(self.camera, distortion) if distortion is not None else None
        self._calibrated: CalibratedStokes | None = None
        if camera_file.polarizers is not None and camera_file.angle_direction is not None:
            self._calibrated = CalibratedStokes(camera_file.polarizers, camera_file.angle_direction)

    def __call__(self, frame: Frame) -> SensedFrame:
        """The frame, of which nothing is computed yet."""
        return SensedFrame(self, frame)

    @property
    def valid(self) -> np.ndarray | None:
        """The pixels that the lens shows, bool H×W; None where that is all of them."""
        return None if self._undistorter is None else self._undistorter.valid

    @cached_property
    def valid_grey(self) -> np.ndarray:
        """The pixels that the lens shows and lets light through to, by the vignette, bool H×W, read-only."""
        vignette = None if self._calibration is None else self._calibration.vignette
        dark = np.zeros(self.camera.shape, np.bool_) if vignette is None else np.asarray(vignette) <= 0
        lit = ~dark if self._undistorter is None else self._undistorter.valid & ~self._undistorter.spread(dark)
        lit.setflags(write=False)
        return lit

    def polarization(self, frame: Frame) -> PolarizationImage:
        """The frame's polarization image, H×W of `camera`.

        Pixels outside the undistorted view have intensity and DoLP 0 and are `underexposed`. `saturated`
        are those that any clipped raw pixel has a part in. Raises InputError where the frame's size is not
        the camera's, or the camera has no polarization.
        """
        file = self._file
        gain = 1.0 if file.layout is None else noise_gain(file.demosaic, file.colour is not None)
        if self._calibrated is not None:
            channels, saturated = self.channels(frame), self._saturated(frame)
            return self._calibrated.image(channels, file.noise, file.bit_depth, gain, saturated)
        return polarization_image(
            self.channels(frame), file.noise, file.bit_depth, gain, saturated=self._saturated(frame)
        )

    def intensity(self, frame: Frame) -> np.ndarray:
        """The polarization image's intensity alone, float32 H×W."""
        if self._calibrated is not None:
            return self._calibrated.intensity(self.channels(frame))
        if self._splits and self._undistorter is None:
            return mean_of_split_light(*self._mosaic(self._raw(frame)))
        return mean_intensity(self.channels(frame))

    def consistency(self, frame: Frame) -> np.ndarray:
        """As `stokes.consistency_residual`, by the polarizers' calibration if there is one, float32 H×W."""
        channels = self.channels(frame)
        return consistency_residual(channels) if self._calibrated is None else self._calibrated.residual(channels)

    def grey(self, frame: Frame) -> np.ndarray:
        """The grey image that odometry works on, float32 H×W in [0, 1], 0 where not `valid_grey`.

        That of a polarization camera is S0/2: the mean of a 2×2 block of the mosaic, which holds each angle once, or of
        the four pictures, weighed by the polarizers' calibration if there is one. However the camera file demosaics,
        nothing is interpolated but a colour sensor's luminance.
        Raises InputError where the frame's size is not the camera's.
        """
        grey = self._mean(np.ascontiguousarray(self._raw(frame)), *self._black_and_scale)
        if self._file.colour is not None:
            # R/4 + G/2 + B/4 of any Bayer pattern, as `mosaic.colour_to_grey` makes of each angle.
            grey = cv2.sepFilter2D(grey, -1, _BINOMIAL, _BINOMIAL, borderType=cv2.BORDER_REFLECT_101)
        if self._calibration is not None:
            grey = corrected(grey, self._calibration)
        return grey if self._undistorter is None else self._undistorter.image(grey)

    def channels(self, frame: Frame) -> np.ndarray:
        """The four channels, float32 4×H×W in the order 0, 45, 90, 135 degrees clockwise as displayed.

        Shares of full scale, black level taken off, undistorted; NaN outside the view. Raises InputError
        where the frame's size is not the camera's, or the camera has no polarization.
        """
        require_polarization(self._file)
        channels = split_light(*self._mosaic(self._raw(frame))) if self._splits else self._channels(self._raw(frame))
        return channels if self._undistorter is None else self._undistorter(channels)

    @property
    def _splits(self) -> bool:
        """Whether each angle's pixels are taken as they are."""
        file = self._file
        return file.polarized and file.layout is not None and file.demosaic == "split" and file.colour is None

    def _mosaic(self, raw: np.ndarray) -> tuple:
        """Arguments of `split_light`."""
        file = self._file
        return np.ascontiguousarray(raw), file.layout, file.angle_direction, *self._black_and_scale

    def _channels(self, raw: np.ndarray) -> np.ndarray:
        light = self._normalized(raw)
        return self._in_order(light) if light.ndim == 3 else self._demosaiced(light)

    @property
    def _black_and_scale(self) -> tuple[np.float32, np.float32]:
        """What a raw value is less, and by which the rest is multiplied for a share of full scale."""
        black = np.float32(self._file.black_level)
        return black, np.float32(1) / (np.float32(self._file.white_level) - black)

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
        return raw

    def _mean(self, raw: np.ndarray, black: np.float32, scale: np.float32) -> np.ndarray:
        if not self._file.polarized:
            return scaled(raw, black, scale)
        if self._calibrated is not None:
            return self._calibrated.intensity(self._undemosaiced(raw))
        return mean_of_pictures(raw, black, scale) if raw.ndim == 3 else mean_of_blocks(raw, black, scale)

    def _undemosaiced(self, raw: np.ndarray) -> np.ndarray:
        """Each angle's own pixels as shares of full scale, float32 4×H×W, clockwise."""
        if self._file.layout is None:
            return self._in_order(self._normalized(raw))
        return split_light(*self._mosaic(raw))

    def _normalized(self, raw: np.ndarray) -> np.ndarray:
        black, scale = self._black_and_scale
        light = raw.astype(np.float32)
        light -= black
        light *= scale
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


def require_polarization(camera_file: CameraFile) -> None:
    """Raise InputError for a camera without polarization."""
    if not camera_file.polarized:
        raise InputError(
            "the sequence has no polarization channels (its camera file says polarization: none); "
            "only odometry works without them"
        )
