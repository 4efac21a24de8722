"""Normals from polarization alone, without a map to resolve what it leaves open."""

from __future__ import annotations

import numpy as np

from polarmap.data.polarization_image import PolarizationImage
from polarmap.errors import InputError
from polarmap.geometry.camera import PinholeCamera
from polarmap.geometry.surface import normals_from_cues
from polarmap.polarization.fresnel import diffuse_dolp, diffuse_zenith, specular_zeniths
from polarmap.polarization.options import CueOptions

_CLEAR = 3.0  # standard deviations of DoLP; noise makes as much of unpolarized light in one pixel of a hundred


def clearly_polarized(image: PolarizationImage) -> np.ndarray:
    """Where there is more polarization than noise feigns, and so an angle to look at, bool H×W."""
    return image.usable & (image.dolp > _CLEAR * image.sigma_dolp)


def upward_normals(image: PolarizationImage, camera: PinholeCamera, options: CueOptions | None = None) -> np.ndarray:
    """Normals that polarization states if light comes from the body and surfaces face upward, float32 H×W×3.

    They are toward the camera, in its frame, NaN where light is not clearly polarized. A single picture does not tell
    them: the same light is seen of a normal mirrored at the line of sight (azimuth + π), and of a mirroring
    surface turned by π/2, at two other zeniths. By convention the azimuth is the one that points upward in the image,
    and light is diffuse. Only where there is more polarization than diffuse light can have, beyond twice its noise,
    light must be specular; then the zenith is the one below the Brewster angle.
    Raises InputError where the image is not of the camera's size.
    """
    options = options or CueOptions()
    if image.aolp.shape != camera.shape:
        raise InputError(f"normals: image {image.aolp.shape} does not fit the camera {camera.shape}")
    eta = options.refractive_index
    specular = image.dolp - 2.0 * image.sigma_dolp > diffuse_dolp(np.pi / 2, eta)
    direction = np.stack([np.cos(image.aolp), np.sin(image.aolp)], axis=-1)
    direction = np.where(specular[..., None], _across(direction, camera, options), direction)
    direction = np.where(direction[..., 1:] > 0.0, -direction, direction)
    zenith = np.where(specular, specular_zeniths(image.dolp, eta)[0], diffuse_zenith(image.dolp, eta))
    azimuth = np.where(clearly_polarized(image), np.arctan2(direction[..., 1], direction[..., 0]), np.nan)
    return normals_from_cues(azimuth.astype(np.float32), zenith, camera, options.orthographic)


def _across(direction: np.ndarray, camera: PinholeCamera, options: CueOptions) -> np.ndarray:
    """Where planes of incidence cut the image that stand across those along `direction`, H×W×2: M d, turned first."""
    across = np.stack([-direction[..., 1], direction[..., 0]], axis=-1)
    if options.orthographic:
        return across
    xy = camera.normalized()
    return across + xy * np.einsum("hwc,hwc->hw", xy, across)[..., None]
