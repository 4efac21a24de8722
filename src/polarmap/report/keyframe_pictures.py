"""The pictures of a keyframe, with colour ranges that all keyframes of a run share."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from polarmap.geometry.surface import normals_from_cues
from polarmap.io.run_folder.results import PictureRanges
from polarmap.polarization.alone import clearly_polarized
from polarmap.report import pictures

if TYPE_CHECKING:
    from polarmap.data.keyframe import Keyframe

# By name, what is shown, and in which format it is small and clear: flat colours as PNG.
PICTURES = {
    "image": ("grey image", "jpg"),
    "depth": ("depth", "jpg"),
    "confidence": ("confidence", "jpg"),
    "normal": ("normals of the map", "jpg"),
    "polarnormal": ("normals of polarization, made unambiguous by the map", "jpg"),
    "label": ("kind of reflection", "png"),
    "origin": ("origin of depth", "png"),
    "dolp": ("degree of linear polarization", "jpg"),
    "aolp": ("angle of linear polarization", "jpg"),
}

_LEAST_DOLP_RANGE = 0.05


def picture_ranges(keyframe: Keyframe) -> PictureRanges:
    """Ranges that suit a keyframe: nearly all of its values, and some depth beyond them."""
    near, far = pictures.depth_limits(keyframe.depth)
    return PictureRanges(
        white=max(float(np.percentile(keyframe.image.intensity, 99)), 1e-3),
        dolp=float(np.clip(np.percentile(keyframe.image.dolp, 98), _LEAST_DOLP_RANGE, 1.0)),
        nearest=0.8 * near,
        farthest=1.2 * far,
    )


def keyframe_pictures(keyframe: Keyframe, ranges: PictureRanges, orthographic: bool = False) -> dict[str, np.ndarray]:
    """A picture for each name of `PICTURES`, RGB uint8 H×W×3.

    Normals of polarization are left dark where light is not clearly polarized, though cues may be read there too.
    orthographic: whether azimuths and zeniths are of an orthographic camera, as the option `cues.orthographic` says.
    """
    stated = normals_from_cues(keyframe.azimuth, keyframe.zenith, keyframe.camera, orthographic)
    stated[~clearly_polarized(keyframe.image)] = np.nan
    return {
        "image": pictures.grey(keyframe.image.intensity, ranges.white),
        "depth": pictures.depth(keyframe.depth, (ranges.nearest, ranges.farthest)),
        "confidence": pictures.confidence(np.where(np.isnan(keyframe.depth), np.nan, keyframe.confidence)),
        "normal": pictures.normals(keyframe.normal),
        "polarnormal": pictures.normals(stated),
        "label": pictures.labels(keyframe.label),
        "origin": pictures.origins(keyframe.origin),
        "dolp": pictures.dolp(keyframe.image.dolp, ranges.dolp),
        "aolp": pictures.aolp(keyframe.image.aolp),
    }
