"""ROS's camera_info: the file that camera_calibration writes, and the message sensor_msgs/CameraInfo as it is printed.

The image is the raw one: K and D count, R and P (of the rectified image) do not.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from polarmap.errors import InputError
from polarmap.io.recording.calibration.fields import Calibration, first_of, from_matrix, number, numbers, required, size
from polarmap.io.recording.calibration.lens_models import lens_distortion


def is_camera_info(values: Mapping[str, Any]) -> bool:
    """Whether a mapping is a camera_info file or message."""
    if {"camera_matrix", "distortion_model"} <= values.keys():
        return True
    return "distortion_model" in values and first_of(values, ("K", "k")) is not None


def read_camera_info(values: Mapping[str, Any]) -> Calibration:
    """The camera. Raises InputError for a region of interest or binning, whose intrinsics are others."""
    _refuse_parts(values)
    matrix = first_of(values, ("camera_matrix", "K", "k"))
    coefficients = first_of(values, ("distortion_coefficients", "D", "d"))
    fx, fy, cx, cy = from_matrix(values[matrix], matrix)
    width, height = (first_of(values, (f"image_{side}", side)) or f"image_{side}" for side in ("width", "height"))
    model = values["distortion_model"] or "plumb_bob"  # left empty by drivers that know of no distortion
    found = numbers(values[coefficients], coefficients) if coefficients is not None else ()
    return Calibration(
        "ROS",
        "",
        size(required(values, width), required(values, height), f"{width}, {height}"),
        fx,
        fy,
        cx,
        cy,
        lens_distortion(model, found),
    )


def _refuse_parts(values: Mapping[str, Any]) -> None:
    for key in ("binning_x", "binning_y"):
        if number(values.get(key, 0), key) > 1:
            raise InputError(
                f"{key}: intrinsics of binned pictures must be given as such; calibrate the pictures as recorded"
            )
    roi = values.get("roi")
    if isinstance(roi, Mapping) and any(number(roi.get(key, 0), f"roi.{key}") for key in ("x_offset", "y_offset")):
        raise InputError("roi: intrinsics of a region must be given as such; calibrate the pictures as recorded")
