"""Lens distortion, and its removal from the channels of a polarization image.

With x = (u-cx)/fx, y = (v-cy)/fy the normalized coordinates of the undistorted image and r² = x² + y², the
lens shows that point at (x', y'):

radtan, the model of Brown (1966), OpenCV's order k1 k2 p1 p2 [k3 [k4 k5 k6]]:

    s  = (1 + k1 r² + k2 r⁴ + k3 r⁶) / (1 + k4 r² + k5 r⁴ + k6 r⁶)
    x' = x s + 2 p1 x y + p2 (r² + 2 x²)
    y' = y s + p1 (r² + 2 y²) + 2 p2 x y

equidistant, the fisheye model of Kannala and Brandt (2006), k1 k2 k3 k4, with θ = atan r:

    (x', y') = (x, y)/r · θ (1 + k1 θ² + k2 θ⁴ + k3 θ⁶ + k4 θ⁸)
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from polarmap.errors import InputError
from polarmap.geometry.camera import PinholeCamera

_ROUNDING = 1e-3  # pixels that a map may be off, so that no distortion keeps the border
_COEFFICIENT_COUNTS = {"radtan": (4, 5, 8), "equidistant": (4,)}


@dataclass(frozen=True)
class Distortion:
    """A distortion model and its coefficients, dimensionless, in the order above.

    Raises InputError for an unknown model, a wrong number of coefficients, or one that is not finite.
    """

    model: str
    coefficients: tuple[float, ...]

    def __post_init__(self) -> None:
        if self.model not in _COEFFICIENT_COUNTS:
            known = " or ".join(_COEFFICIENT_COUNTS)
            raise InputError(f"distortion: model {self.model!r} is not known; write {known}")
        counts = _COEFFICIENT_COUNTS[self.model]
        if len(self.coefficients) not in counts:
            expected = " or ".join(map(str, counts))
            raise InputError(f"distortion: {self.model} takes {expected} coefficients, not {len(self.coefficients)}")
        if not np.isfinite(self.coefficients).all():
            raise InputError("distortion: the coefficients must be finite numbers")

    def distorted_radius(self, radius: np.ndarray) -> np.ndarray:
        """Distorted for undistorted normalized radius, same shape, tangential terms left out."""
        radius = np.asarray(radius, float)
        if self.model == "equidistant":
            angle = np.arctan(radius)
            return angle * _even_polynomial(angle, self.coefficients)
        k1, k2, _, _, k3, k4, k5, k6 = (*self.coefficients, 0.0, 0.0, 0.0, 0.0)[:8]
        return radius * _even_polynomial(radius, (k1, k2, k3)) / _even_polynomial(radius, (k4, k5, k6))

    def field_radius(self, limit: float) -> float:
        """The largest undistorted radius up to `limit` until which the distorted one grows.

        Beyond it the polynomial folds back: it would show pixels of the image's inside a second time.
        """
        radius = np.linspace(0.0, limit, 4097)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            growing = np.diff(self.distorted_radius(radius)) > 0
        return limit if growing.all() else float(radius[np.argmin(growing)])


def _even_polynomial(t: np.ndarray, coefficients: tuple[float, ...]) -> np.ndarray:
    """1 + c1 t² + c2 t⁴ + ..."""
    value = np.zeros_like(t)
    for coefficient in reversed(coefficients):
        value = (value + coefficient) * t * t
    return 1.0 + value


def undistortion_maps(camera: PinholeCamera, distortion: Distortion) -> tuple[np.ndarray, np.ndarray]:
    """Where each pixel of the undistorted image lies in the distorted one, both with the same K.

    Returns map_x, map_y, float32 H×W, in pixels of the distorted image; NaN beyond the lens model's field.
    """
    K, size = camera.matrix, (camera.width, camera.height)
    coefficients = np.array(distortion.coefficients)
    make = cv2.fisheye.initUndistortRectifyMap if distortion.model == "equidistant" else cv2.initUndistortRectifyMap
    map_x, map_y = make(K, coefficients, np.eye(3), K, size, cv2.CV_32FC1)
    radius = np.linalg.norm(camera.normalized(), axis=-1)
    outside = radius > distortion.field_radius(float(radius.max()))
    map_x[outside] = map_y[outside] = np.nan
    return map_x, map_y


class Undistorter:
    """Undoes a camera's distortion, its maps computed once.

    `valid`, bool H×W, read-only: the pixels of the undistorted image that the lens shows.
    """

    def __init__(self, camera: PinholeCamera, distortion: Distortion) -> None:
        map_x, map_y = undistortion_maps(camera, distortion)
        self.camera = camera
        inside_x = (map_x > -_ROUNDING) & (map_x < camera.width - 1 + _ROUNDING)
        inside_y = (map_y > -_ROUNDING) & (map_y < camera.height - 1 + _ROUNDING)
        self.valid = inside_x & inside_y
        self.valid.setflags(write=False)
        self._outside = ~self.valid
        map_x[self._outside] = map_y[self._outside] = 0.0
        self._maps = map_x, map_y

    def __call__(self, channels: np.ndarray) -> np.ndarray:
        """Undistorted channels, float32 C×H×W, bilinear, NaN where not `valid`.

        channels: float32 C×H×W of the distorted image. Raises InputError where H×W is not the camera's.
        """
        self._check(channels.shape[1:])
        undistorted = np.empty(channels.shape, np.float32)
        for source, target in zip(channels, undistorted, strict=True):
            self._remap(source.astype(np.float32, copy=False), target)
            target[self._outside] = np.nan
        return undistorted

    def image(self, image: np.ndarray) -> np.ndarray:
        """Undistorted image, float32 H×W, bilinear, 0 where not `valid`; float32 H×W in, InputError as above."""
        self._check(image.shape)
        undistorted = self._remap(image, np.empty(image.shape, np.float32))
        undistorted[self._outside] = 0.0
        return undistorted

    def spread(self, mask: np.ndarray) -> np.ndarray:
        """Undistorted pixels that are interpolated from one of `mask`, bool H×W; false where not `valid`."""
        self._check(mask.shape)
        share = self._remap(mask.astype(np.float32), np.empty(mask.shape, np.float32))
        return (share > 0) & self.valid

    def _remap(self, source: np.ndarray, target: np.ndarray) -> np.ndarray:
        return cv2.remap(source, *self._maps, cv2.INTER_LINEAR, dst=target, borderMode=cv2.BORDER_REPLICATE)

    def _check(self, shape: tuple[int, ...]) -> None:
        if shape != self.camera.shape:
            found, expected = ("x".join(map(str, size[::-1])) for size in (shape, self.camera.shape))
            raise InputError(f"undistortion: the image has {found} pixels, the camera {expected}")
