"""Settings of ORB-SLAM2, ORB-SLAM3 and stella_vslam (OpenVSLAM): `Camera.fx`, or `Camera1.fx` and so on."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from polarmap.errors import InputError
from polarmap.io.recording.calibration.fields import Calibration, chosen, first_of, number, required, size
from polarmap.io.recording.calibration.lens_models import lens_distortion

_FOCAL = re.compile(r"(Camera\d?)\.fx")
_RADTAN = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
_FISHEYE = ("k1", "k2", "k3", "k4")


def is_orb_slam(values: Mapping[str, Any]) -> bool:
    """Whether a mapping has a camera's focal length under such a name."""
    return bool(_cameras(values))


def read_orb_slam(values: Mapping[str, Any]) -> Calibration:
    """The camera, or of two the one that `camera: Camera2` names."""
    name = chosen(_cameras(values), values.get("camera"))
    fx, fy, cx, cy = (number(required(values, f"{name}.{key}"), f"{name}.{key}") for key in ("fx", "fy", "cx", "cy"))
    rate = first_of(values, ("Camera.fps",))
    return Calibration(
        "ORB-SLAM",
        name,
        _size(values),
        fx,
        fy,
        cx,
        cy,
        _distortion(values, name),
        number(values[rate], rate) if rate is not None else None,
    )


def _cameras(values: Mapping[str, Any]) -> list[str]:
    return [found[1] for key in values if (found := _FOCAL.fullmatch(key))]


def _distortion(values: Mapping[str, Any], name: str):
    """stella_vslam says `Camera.model`, the others `Camera.type`; a rectified camera has no distortion."""
    model = str(values[first_of(values, ("Camera.type", "Camera.model")) or ""]) if _has_model(values) else "PinHole"
    kind = model.lower()
    if kind == "rectified":
        return None
    if kind in ("pinhole", "perspective"):
        return lens_distortion("radtan", _coefficients(values, name, _RADTAN))
    if kind in ("kannalabrandt8", "fisheye"):
        return lens_distortion("equidistant", _coefficients(values, name, _FISHEYE))
    lens_distortion(model, ())
    raise InputError(f"Camera.type: {model[:40]} is not known here; write PinHole, Rectified or KannalaBrandt8")


def _has_model(values: Mapping[str, Any]) -> bool:
    return first_of(values, ("Camera.type", "Camera.model")) is not None


def _coefficients(values: Mapping[str, Any], name: str, keys: tuple[str, ...]) -> tuple[float, ...]:
    """As many as the model needs; those that are left out are 0."""
    given = [number(values.get(f"{name}.{key}", 0.0), f"{name}.{key}") for key in keys]
    if keys is _FISHEYE or any(given[5:]):
        return tuple(given)
    return tuple(given[:5])


def _size(values: Mapping[str, Any]) -> tuple[int, int] | None:
    width, height = (
        first_of(values, names) for names in (("Camera.width", "Camera.cols"), ("Camera.height", "Camera.rows"))
    )
    return None if width is None or height is None else size(values[width], values[height], f"{width}, {height}")
