"""Calibrations that OpenCV's FileStorage holds, under the names that its samples and common programs give them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from polarmap.io.recording.calibration.fields import Calibration, chosen, first_of, from_matrix, number, numbers, size
from polarmap.io.recording.calibration.lens_models import lens_distortion

_MATRICES = (
    "camera_matrix",
    "Camera_Matrix",
    "cameraMatrix",
    "CameraMatrix",
    "camera_Matrix",
    "intrinsic_matrix",
    "K",
    "mtx",
)
_COEFFICIENTS = (
    "distortion_coefficients", "Distortion_Coefficients", "distCoeffs", "dist_coeffs", "distortion", "dist_coeff",
    "distCoeff", "distortionCoefficients", "D", "dist",
)  # fmt: skip
_WIDTHS = ("image_width", "image_Width", "imageWidth", "width")
_HEIGHTS = ("image_height", "image_Height", "imageHeight", "height")
_SIZES = ("image_size", "imageSize", "size")
_STEREO = {"M1": "D1", "M2": "D2", "K1": "D1", "K2": "D2"}  # the stereo sample's two cameras
_FISHEYE = ("fisheye_model", "fisheye", "is_fisheye")


def is_opencv(values: Mapping[str, Any]) -> bool:
    """Whether a mapping has a camera matrix."""
    return _matrices(values) != []


def read_opencv(values: Mapping[str, Any]) -> Calibration:
    """The camera, or of two the one that `camera: M1` names."""
    names = _matrices(values)
    name = names[0] if names[0] in _MATRICES else chosen(names, values.get("camera"))
    coefficients = _STEREO.get(name) or first_of(values, _COEFFICIENTS)
    found = numbers(values[coefficients], coefficients) if coefficients in values else ()
    flag = first_of(values, _FISHEYE)
    fisheye = flag is not None and number(int(values[flag]) if values[flag] in (True, False) else values[flag], flag)
    fx, fy, cx, cy = from_matrix(values[name], name)
    distortion = lens_distortion("fisheye" if fisheye else "radtan", found)
    return Calibration("OpenCV", name if name in _STEREO else "", _size(values), fx, fy, cx, cy, distortion)


def _matrices(values: Mapping[str, Any]) -> list[str]:
    """The camera matrix's key, or those of a stereo pair."""
    plain = [key for key in _MATRICES if isinstance(values.get(key), Mapping | list)]
    return plain[:1] or [key for key in _STEREO if isinstance(values.get(key), Mapping | list)]


def _size(values: Mapping[str, Any]) -> tuple[int, int] | None:
    width, height, both = first_of(values, _WIDTHS), first_of(values, _HEIGHTS), first_of(values, _SIZES)
    if width is not None and height is not None:
        return size(values[width], values[height], f"{width}, {height}")
    return size(*numbers(values[both], both, 2), both) if both is not None else None
