"""EuRoC's sensor.yaml of a camera (ASL data set format): intrinsics, resolution and distortion_coefficients."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from polarmap.io.recording.calibration.fields import Calibration, number
from polarmap.io.recording.calibration.kalibr import pinhole_camera


def is_euroc(values: Mapping[str, Any]) -> bool:
    """Whether a mapping is a sensor.yaml."""
    return {"camera_model", "intrinsics"} <= values.keys()


def read_euroc(values: Mapping[str, Any]) -> Calibration:
    """The camera, with its frame rate where the file gives one."""
    found = pinhole_camera("EuRoC", values, "", coefficients="distortion_coefficients")
    return replace(found, frame_rate=number(values["rate_hz"], "rate_hz")) if "rate_hz" in values else found
