"""COLMAP's cameras.txt, as a calibration: one camera."""

from __future__ import annotations

from pathlib import Path

from polarmap.errors import InputError
from polarmap.io.files import read_bytes
from polarmap.io.formats.colmap import CAMERA_MODELS, ColmapCamera, read_text_cameras
from polarmap.io.formats.yaml_text import MAX_YAML_BYTES
from polarmap.io.recording.calibration.fields import Calibration
from polarmap.io.recording.calibration.lens_models import lens_distortion

_LOOKED_AT = 4096  # bytes
_PADDED = {"SIMPLE_RADIAL": 4, "RADIAL": 4}  # k1 [k2], which are followed by zeros


def is_colmap(path: Path) -> bool:
    """Whether a file's first line that is no comment is a camera's: CAMERA_ID MODEL WIDTH HEIGHT PARAMS."""
    text = read_bytes(path, MAX_YAML_BYTES)[:_LOOKED_AT].decode("ascii", "replace")
    words = next((words for line in text.splitlines() if (words := line.split()) and not line.startswith("#")), [])
    return len(words) > 4 and words[0].isdecimal() and words[1] in CAMERA_MODELS


def read_colmap(path: Path) -> Calibration:
    """The file's camera; its centre is moved to where the first pixel's centre is at (0, 0)."""
    cameras = read_text_cameras(path)
    if len(cameras) > 1:
        ids = ", ".join(str(number) for number, _ in cameras[:5])
        raise InputError(f"holds {len(cameras)} cameras ({ids}); keep the line of the one that is meant")
    _, camera = cameras[0]
    pinhole = camera.pinhole
    return Calibration(
        "COLMAP",
        "",
        (pinhole.width, pinhole.height),
        pinhole.fx,
        pinhole.fy,
        pinhole.cx,
        pinhole.cy,
        _distortion(camera),
    )


def _distortion(camera: ColmapCamera):
    if camera.model in ("SIMPLE_PINHOLE", "PINHOLE"):
        return None
    if camera.model in ("SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE"):  # k1 [k2] of θ³ and θ⁵
        return lens_distortion("equidistant", (*camera.distortion, 0.0, 0.0, 0.0)[:4])
    if camera.model in _PADDED:
        return lens_distortion("radtan", (*camera.distortion, 0.0, 0.0, 0.0)[: _PADDED[camera.model]])
    return lens_distortion(camera.model, camera.distortion)
