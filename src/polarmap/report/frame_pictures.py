"""Pictures of what the sensor saw in a frame: intensity, degree and angle of polarization, exposure, normals."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from polarmap.data.polarization_image import PolarizationImage
from polarmap.errors import PolarmapError
from polarmap.geometry.camera import PinholeCamera
from polarmap.io.files import reason
from polarmap.io.formats.images import write_image
from polarmap.polarization.alone import upward_normals
from polarmap.report import pictures
from polarmap.sensing.inspection import POLARIZED

OVERVIEW_WIDTH = 1200  # pixels
_WHEEL_SHARE = 0.16  # of the overview's panel height


def frame_pictures(image: PolarizationImage, camera: PinholeCamera) -> dict[str, np.ndarray]:
    """The pictures of one frame by name, each RGB uint8 H×W×3; the overview at most 1200 pixels wide.

    Brightness is scaled to the 99th percentile of the frame, DoLP to the 98th, at least 0.05. Normals are those of
    polarization alone, ambiguous as they are (`upward_normals`).
    """
    white = max(float(np.percentile(image.intensity, 99)), 1e-3)
    full = float(np.clip(np.percentile(image.dolp, 98), POLARIZED, 1.0))
    panels = {
        "s0": pictures.grey(image.intensity, white),
        "dolp": pictures.dolp(image.dolp, full),
        "aolp": pictures.aolp(image.aolp),
        "polarization": pictures.polarization(image.aolp, image.dolp, full),
        "exposure": pictures.exposure(image.intensity, image.saturated, image.underexposed),
        "polarnormal": pictures.normals(upward_normals(image, camera)),
    }
    return {**panels, "overview": _overview(panels)}


def write_pictures(folder: Path, name: str, image: PolarizationImage, camera: PinholeCamera) -> list[Path]:
    """Write `<name>_s0.png`, `_dolp`, `_aolp`, `_polarization`, `_exposure`, `_polarnormal` and `<name>_overview.jpg`.

    Makes the folder. Returns the files' paths. Raises PolarmapError where they cannot be written.
    """
    folder, paths = Path(folder), []
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise PolarmapError(f"{folder}: cannot be made ({reason(error)})") from None
    for kind, picture in frame_pictures(image, camera).items():
        paths.append(folder / f"{name}_{kind}.{'jpg' if kind == 'overview' else 'png'}")
        write_image(paths[-1], cv2.cvtColor(picture, cv2.COLOR_RGB2BGR))
    return paths


def _overview(panels: dict[str, np.ndarray]) -> np.ndarray:
    """S0, DoLP and AoLP side by side, with the colour wheel of the angles."""
    chosen = [panels[kind] for kind in ("s0", "dolp", "aolp")]
    height, width = chosen[0].shape[:2]
    scale = min(1.0, OVERVIEW_WIDTH / (3 * width))
    size = max(1, int(width * scale)), max(1, int(height * scale))
    chosen = [cv2.resize(picture, size, interpolation=cv2.INTER_AREA) for picture in chosen]
    wheel = pictures.aolp_wheel(max(8, int(_WHEEL_SHARE * size[1])))
    corner = chosen[2][-wheel.shape[0] :, -wheel.shape[1] :]
    wheel = wheel[: corner.shape[0], : corner.shape[1]]
    np.copyto(corner, wheel, where=wheel.any(axis=-1, keepdims=True))
    return pictures.montage(chosen, gap=0)
