"""The camera file, `camera.yaml`: calibration and sensor of a polarization or plain camera (see docs/formats.md)."""

from __future__ import annotations

import difflib
import math
import os
from contextlib import suppress
from pathlib import Path
from typing import Annotated, Any, Literal

import yaml
from pydantic import BaseModel, BeforeValidator, ConfigDict, PlainValidator, StrictInt, ValidationError

from polarmap.data.camera_file import DEMOSAIC_METHODS, CameraFile, PhotometricFiles
from polarmap.data.pixel_format import PixelFormat
from polarmap.data.polarizers import PolarizerCalibration
from polarmap.data.sensor import AngleDirection, SensorLayout, SensorNoise
from polarmap.errors import InputError
from polarmap.geometry.camera import PinholeCamera
from polarmap.io.files import write_bytes
from polarmap.io.formats.images import ImageHeader
from polarmap.io.recording.calibration import CAMERA_FILE_NAME as CAMERA_FILE_NAME
from polarmap.io.recording.calibration import camera_file_values, lens_distortion

MINIMAL_CAMERA_FILE = (
    "{width: 1224, height: 1024, fx: 1900, fy: 1900, cx: 611.5, cy: 511.5, bit_depth: 8, "
    "mosaic: [90, 45, 135, 0], angle_direction: counterclockwise}"
)


def read_camera_file(path: Path, sequence: Path | None = None, picture: ImageHeader | None = None) -> CameraFile:
    """The camera that a YAML file describes, or another program's calibration file (`io.recording.calibration`).

    sequence: the folder, picture or bag that it is for. A calibration takes from there what it does not know: the
    sensor, from the sequence's own camera.yaml, and whether its numbers are of the mosaic or of a channel. picture:
    what one of the sequence's pictures says of itself, where they are in no files.
    Raises InputError naming file and key where it is not as documented.
    """
    path = Path(path)
    mapping = _load_mapping(path, None if sequence is None else Path(sequence), picture)
    return camera_file_of(path, mapping, path.parent)


def camera_file_of(where: Path | str, mapping: dict[str, Any], folder: Path) -> CameraFile:
    """The camera that the keys of a camera file describe.

    where: what messages name. folder: which relative paths start from. Raises InputError as `read_camera_file` does.
    """
    try:
        return _Schema.model_validate(mapping).camera_file(folder)
    except ValidationError as error:
        raise InputError(f"{where}: {_first_problem(error)}") from None
    except InputError as problem:
        raise InputError(f"{where}: {problem}") from None


def write_camera_file(path: Path, camera_file: CameraFile) -> None:
    """Write a camera file from which `read_camera_file` makes an equal CameraFile.

    Raises PolarmapError where the file cannot be written.
    """
    camera, noise, distortion = camera_file.camera, camera_file.noise, camera_file.distortion
    values = {
        "model": "pinhole",
        **{key: int(getattr(camera, key)) for key in ("width", "height")},
        **{key: float(getattr(camera, key)) for key in ("fx", "fy", "cx", "cy")},
        **_polarization_values(camera_file),
        "bit_depth": camera_file.bit_depth,
        "bit_alignment": camera_file.bit_alignment,
        "pixel_format": camera_file.pixel_format.label,
        "black_level": float(camera_file.black_level),
        "colour": camera_file.colour or "none",
        "demosaic": camera_file.demosaic,
        "noise": {"full_well": float(noise.full_well), "read_noise": float(noise.read_noise)},
    }
    if distortion is not None:
        coefficients = [float(k) for k in distortion.coefficients]
        values["distortion"] = {"model": distortion.model, "coefficients": coefficients}
    for key in ("frame_rate", "depth_scale"):
        if getattr(camera_file, key) is not None:
            values[key] = float(getattr(camera_file, key))
    if camera_file.images is not None:
        values["images"] = camera_file.images
    if camera_file.photometric is not None:
        values["photometric"] = _photometric_values(camera_file.photometric, Path(path).parent)
    if (polarizers := camera_file.polarizers) is not None:
        values["calibration"] = {
            key: [float(number) for number in getattr(polarizers, key)] for key in _Polarizers.model_fields
        }
    text = yaml.safe_dump(values, sort_keys=False, default_flow_style=None)
    write_bytes(Path(path), text.encode())


def _polarization_values(camera_file: CameraFile) -> dict[str, Any]:
    if not camera_file.polarized:
        return {"polarization": "none"}
    return {
        "mosaic": list(camera_file.layout.value) if camera_file.layout else "none",
        "angle_direction": camera_file.angle_direction.value,
    }


def _photometric_values(files: PhotometricFiles, folder: Path) -> dict[str, str]:
    paths = {"response": files.response, "vignette": files.vignette}
    return {key: _relative(path, folder) for key, path in paths.items() if path is not None}


def _relative(path: Path, folder: Path) -> str:
    """The path from a folder, with slashes; as it is where they lie on different drives."""
    try:
        return Path(os.path.relpath(path, folder)).as_posix()
    except ValueError:
        return path.as_posix()


def _number(value: object) -> object:
    """YAML 1.1 reads 1e-5, with no dot, as text; true is no number though Python's bool is an int."""
    number = math.nan
    if isinstance(value, (str, int, float)) and not isinstance(value, bool):
        with suppress(ValueError, OverflowError):
            number = float(value)
    if not math.isfinite(number):
        raise ValueError("not a finite number")
    return number


def _layout(value: object) -> SensorLayout | None:
    """The layout in one list of four angles or two of two; None for the text "none"."""
    if value == "none":
        return None
    rows = value if isinstance(value, list) else []
    nested = len(rows) == 2 and all(isinstance(row, list) and len(row) == 2 for row in rows)
    angles = [*rows[0], *rows[1]] if nested else rows
    if len(angles) != 4 or not all(type(angle) is int for angle in angles):
        raise ValueError("not the four angles of a block")
    return SensorLayout.from_angles(angles)


def _distortion(value: object) -> object:
    """Also the text "none", and OpenCV's coefficients alone."""
    if value == "none":
        return None
    return {"model": "radtan", "coefficients": value} if isinstance(value, list) else value


_Number = Annotated[float, BeforeValidator(_number)]


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", arbitrary_types_allowed=True)


class _Distortion(_Strict):
    model: str
    coefficients: list[_Number] = []


class _Noise(_Strict):
    full_well: _Number = SensorNoise.full_well
    read_noise: _Number = SensorNoise.read_noise


class _Photometric(_Strict):
    response: str | None = None
    vignette: str | None = None


_IDEAL = PolarizerCalibration(angles=(0.0, 45.0, 90.0, 135.0))
_Four = tuple[_Number, _Number, _Number, _Number]


class _Polarizers(_Strict):
    angles: _Four = _IDEAL.angles
    gains: _Four = _IDEAL.gains
    efficiencies: _Four = _IDEAL.efficiencies


class _Schema(_Strict):
    """The file's keys and their types; what values they may have, CameraFile and its parts check."""

    model: Literal["pinhole"] = "pinhole"
    width: StrictInt
    height: StrictInt
    fx: _Number
    fy: _Number
    cx: _Number
    cy: _Number
    polarization: Literal["none"] | None = None
    mosaic: Annotated[SensorLayout | None, PlainValidator(_layout)] = None
    angle_direction: Literal["clockwise", "counterclockwise"] | None = None
    bit_depth: StrictInt | None = None
    bit_alignment: str = "lsb"
    pixel_format: str | None = None
    black_level: _Number = 0.0
    colour: str | None = None
    demosaic: str = "split"
    distortion: Annotated[_Distortion | None, BeforeValidator(_distortion)] = None
    noise: _Noise = _Noise()
    frame_rate: _Number | None = None
    depth_scale: _Number | None = None
    images: str | None = None
    photometric: _Photometric | None = None
    calibration: _Polarizers | None = None

    def camera_file(self, folder: Path) -> CameraFile:
        """The description in the package's own types; InputError where values are out of range.

        folder: that of the camera file, which the paths in it start from.
        """
        self._check_polarization()
        pixel_format = None if self.pixel_format is None else PixelFormat.from_name(self.pixel_format)
        if self.bit_depth is None and pixel_format is None:
            raise InputError(_missing("bit_depth"))
        distortion = self.distortion
        same = self.model_dump(include=_SAME_KEYS)
        return CameraFile(
            camera=PinholeCamera(self.width, self.height, self.fx, self.fy, self.cx, self.cy),
            layout=self.mosaic,
            angle_direction=None if self.polarization == "none" else AngleDirection(self.angle_direction),
            bit_depth=pixel_format.bits if self.bit_depth is None else self.bit_depth,
            pixel_format=pixel_format,
            colour=None if self.colour == "none" else self.colour,
            distortion=distortion and lens_distortion(distortion.model, distortion.coefficients),
            noise=SensorNoise(self.noise.full_well, self.noise.read_noise),
            photometric=self._photometric_files(folder),
            polarizers=None if self.calibration is None else PolarizerCalibration(**self.calibration.model_dump()),
            **same,
        )

    def _check_polarization(self) -> None:
        if self.polarization == "none":
            if self.angle_direction is not None:
                raise InputError("angle_direction: leave it out, as polarization is none; or leave out polarization")
        elif "mosaic" not in self.model_fields_set:
            raise InputError(_missing("mosaic"))
        elif self.angle_direction is None:
            raise InputError(_missing("angle_direction"))

    def _photometric_files(self, folder: Path) -> PhotometricFiles | None:
        if self.photometric is None:
            return None
        names = self.photometric.response, self.photometric.vignette
        return PhotometricFiles(*(None if name is None else folder / name for name in names))


_SAME_KEYS = {"bit_alignment", "black_level", "demosaic", "frame_rate", "depth_scale", "images"}
_SECTIONS: dict[str, type[BaseModel]] = {
    "distortion": _Distortion,
    "noise": _Noise,
    "photometric": _Photometric,
    "calibration": _Polarizers,
}
_WHAT_TO_WRITE = {
    **dict.fromkeys(("width", "height"), "a whole number of pixels, of one polarization channel or plain picture"),
    "model": "pinhole; a lens's distortion has a key of its own, distortion",
    "mosaic": "the angles 0, 45, 90 and 135 of a 2x2 block row by row (of Sony's sensors, as IMX250MZR, "
    "[90, 45, 135, 0]), or none for one picture per angle; "
    "for a camera without polarizers write polarization: none",
    "polarization": "none for a camera without polarizers, or leave it out",
    "angle_direction": "clockwise or counterclockwise: which way the polarizer angles turn, as displayed",
    "bit_depth": "8, 10, 12 or 16",
    "bit_alignment": "lsb or msb",
    "pixel_format": "a name such as Mono12Packed",
    "colour": "a Bayer pattern such as RGGB, or none",
    "demosaic": ", ".join(DEMOSAIC_METHODS),
    "distortion": "none, {model: radtan, coefficients: [k1, k2, p1, p2]} or {model: equidistant, coefficients: "
    "[k1, k2, k3, k4]}",
    "noise": "{full_well: 10000, read_noise: 2.5}, in electrons",
    "images": "the name of the pictures' folder inside the sequence's",
    "photometric": "{response: pcalib.txt, vignette: vignette.png}, or one of the two",
    "calibration": "{angles: [0, 45, 90, 135], gains: [1, 1, 1, 1], efficiencies: [1, 1, 1, 1]}, of the channels 0, "
    "45, 90 and 135, as polarmap calibrate makes it",
}


def _load_mapping(path: Path, sequence: Path | None, picture: ImageHeader | None) -> dict[str, Any]:
    mapping = camera_file_values(path, sequence, picture)
    if not isinstance(mapping, dict) or not all(isinstance(key, str) for key in mapping):
        raise InputError(f"{path}: not a list of `key: value` lines; write for example {MINIMAL_CAMERA_FILE}")
    return mapping


def _first_problem(error: ValidationError) -> str:
    """One line for the most telling of the problems: a misspelt key before the one that it leaves missing."""
    problems = error.errors(include_url=False)
    problem = min(problems, key=lambda p: p["type"] != "extra_forbidden")
    *parents, key = (str(part) for part in problem["loc"])
    name = ".".join([*parents, key])
    if problem["type"] == "extra_forbidden":
        known = _SECTIONS.get(parents[0] if parents else "", _Schema)
        near = difflib.get_close_matches(key, known.model_fields, n=1)
        hint = f"did you mean {near[0]}?" if near else f"known are {', '.join(known.model_fields)}"
        return f"unknown key {name[:60] if name.isprintable() else repr(name[:60])}; {hint}"
    if problem["type"] == "missing":
        return _missing(name)
    return f"{name}: {_shown(problem['input'])} cannot be used; write {_what_to_write(name)}"


def _missing(name: str) -> str:
    return f"{name} is missing; write {_what_to_write(name)}"


def _what_to_write(name: str) -> str:
    return _WHAT_TO_WRITE.get(name.split(".")[0], "a finite number")


def _shown(value: object) -> str:
    """A value in a message: short, and never the expansion of what YAML aliases may nest."""
    return repr(value)[:40] if isinstance(value, (str, int, float, bool, type(None))) else "this value"
