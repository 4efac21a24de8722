"""Settings of a camera: what the user sets, and what polarization does not bear."""

from __future__ import annotations

import logging
import math
from collections.abc import Iterable

from polarmap.errors import InputError, quoted
from polarmap.io.cameras.device import Device

log = logging.getLogger(__name__)

_AUTOMATIC = ("ExposureAuto", "GainAuto", "BalanceWhiteAuto", "BlackLevelAuto")
_ALTERING = ("GammaEnable", "LUTEnable", "SharpeningEnable")
_OFF = ("off", "false", "0")
_EXPOSURES = ("ExposureTime", "ExposureTimeAbs")  # microseconds; the second in older cameras


def set_features(device: Device, settings: Iterable[str]) -> None:
    """Set features given as NAME=VALUE, in their order; InputError where one is not so, or not taken."""
    for setting in settings:
        name, equals, value = setting.partition("=")
        if not (name and equals):
            raise InputError(f"--feature {quoted(setting)}: write NAME=VALUE, such as ExposureTime=4000")
        device.set_feature(name.strip(), value.strip())


def warn_of_features(device: Device) -> None:
    """A warning, in one line, of all that is on and changes pixel values from frame to frame or pixel to pixel."""
    on = [name for name in (*_AUTOMATIC, *_ALTERING) if (device.feature(name) or "off").lower() not in _OFF]
    if on:
        off = " ".join(f"--feature {name}={'Off' if name in _AUTOMATIC else 'false'}" for name in on)
        log.warning("%s: %s on, which falsifies polarization or tracking; add %s", device.name, ", ".join(on), off)


def fixed_exposure(device: Device) -> float:
    """Seconds that every picture is exposed; NaN where the camera does not tell, or changes it by itself."""
    if (device.feature("ExposureAuto") or "off").lower() not in _OFF:
        return math.nan
    return next((1e-6 * value for name in _EXPOSURES if (value := number(device, name)) > 0), math.nan)


def number(device: Device, name: str) -> float:
    """The value of a feature; NaN where the camera has none of that name."""
    try:
        return float(device.feature(name) or "nan")
    except ValueError:
        return math.nan


def size_of(device: Device) -> tuple[int, int] | None:
    """(width, height) in pixels of what the camera is set to send; None where it does not tell."""
    width, height = number(device, "Width"), number(device, "Height")
    return None if math.isnan(width + height) else (int(width), int(height))
