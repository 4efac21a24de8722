"""Camera files of camodocal, which VINS-Mono and VINS-Fusion read: model_type and projection_parameters."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from polarmap.errors import InputError
from polarmap.io.recording.calibration.fields import Calibration, number, required, size
from polarmap.io.recording.calibration.lens_models import lens_distortion


def is_camodocal(values: Mapping[str, Any]) -> bool:
    """Whether a mapping is such a camera."""
    return "model_type" in values and isinstance(values.get("projection_parameters"), Mapping)


def read_camodocal(values: Mapping[str, Any]) -> Calibration:
    """A PINHOLE or KANNALA_BRANDT camera; InputError for MEI, SCARAMUZZA and others."""
    model, projection = str(values["model_type"]).upper(), values["projection_parameters"]
    if model == "PINHOLE":
        intrinsics = _numbers(projection, ("fx", "fy", "cx", "cy"))
        part = values.get("distortion_parameters")
        lens = _numbers(part, ("k1", "k2", "p1", "p2")) if isinstance(part, Mapping) else ()
        distortion = lens_distortion("radtan", lens)
    elif model == "KANNALA_BRANDT":  # k2 is the factor of θ³, which others call k1
        intrinsics = _numbers(projection, ("mu", "mv", "u0", "v0"))
        distortion = lens_distortion("equidistant", _numbers(projection, ("k2", "k3", "k4", "k5")))
    else:
        lens_distortion(model, ())
        raise InputError(f"model_type: {model[:40]} is not known here; calibrate as PINHOLE or KANNALA_BRANDT")
    shape = size(required(values, "image_width"), required(values, "image_height"), "image_width, image_height")
    return Calibration("camodocal", "", shape, *intrinsics, distortion)


def _numbers(mapping: Mapping[str, Any], keys: tuple[str, ...]) -> tuple[float, ...]:
    return tuple(number(required(mapping, key), key) for key in keys)
