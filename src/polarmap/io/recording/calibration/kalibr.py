"""Kalibr's camchain.yaml: cam0, cam1 and so on, each with camera_model, intrinsics and distortion."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from polarmap.errors import InputError
from polarmap.io.recording.calibration.fields import Calibration, chosen, numbers, required, size
from polarmap.io.recording.calibration.lens_models import lens_distortion


def is_kalibr(values: Mapping[str, Any]) -> bool:
    """Whether a mapping is a camera chain."""
    return bool(_cameras(values))


def read_kalibr(values: Mapping[str, Any]) -> Calibration:
    """The camera of a chain, or the one that `camera: cam1` names."""
    name = chosen(_cameras(values), values.get("camera"))
    return pinhole_camera("Kalibr", values[name], name, coefficients="distortion_coeffs")


def pinhole_camera(program: str, camera: Mapping[str, Any], name: str, coefficients: str) -> Calibration:
    """A camera with the keys camera_model, intrinsics, resolution and distortion_model, as Kalibr and EuRoC have it."""
    model = str(camera.get("camera_model", "pinhole"))
    if model.lower() != "pinhole":
        lens_distortion(model, ())  # which refuses omni, eucm, ds and others by their names
        raise InputError(f"camera_model: {model[:40]} is not known here; calibrate with pinhole-radtan or pinhole-equi")
    fx, fy, cx, cy = numbers(required(camera, "intrinsics"), "intrinsics", 4)
    values = numbers(camera.get(coefficients, []), coefficients)
    resolution = numbers(required(camera, "resolution"), "resolution", 2)
    distortion = lens_distortion(camera.get("distortion_model", "radtan"), values)
    return Calibration(program, name, size(*resolution, "resolution"), fx, fy, cx, cy, distortion)


def _cameras(values: Mapping[str, Any]) -> list[str]:
    return [
        key
        for key, part in values.items()
        if isinstance(part, Mapping) and {"camera_model", "intrinsics"} <= part.keys()
    ]
