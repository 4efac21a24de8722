"""Pixels whose normal and polarization are both known, and so can tell what their surface is made of."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import prange

from polarmap.data.polarization_image import PolarizationImage
from polarmap.errors import InputError
from polarmap.geometry.camera import PinholeCamera
from polarmap.jit import njit
from polarmap.materials.regions import smooth_regions

DIFFUSE, SPECULAR = 1, 2

_MOST = 80_000  # pixels that are looked at
_LEAST_ZENITH = np.float32(np.radians(20.0))  # below it the degree hardly depends on the material
_LARGEST_ZENITH = np.float32(np.radians(78.0))  # above it, it hardly depends on anything but the zenith
_ANGLE_TOLERANCE = np.float32(np.radians(15.0))
_CLEAR_ANGLE = np.float32(np.radians(8.0))  # largest standard deviation of the angle of a sample
_CLEAR_DEGREE = np.float32(4.0)  # least degree, in standard deviations


@dataclass(frozen=True)
class MaterialSamples:
    """N pixels with a clear angle of polarization, of R regions.

    kind: uint8, 1 if the angle is that of light from the body within 15°, 2 if from the surface, 0 if neither.
    zenith: of the given normal, radians. dolp, sigma_dolp: of the pixel, noise's bias removed. log_intensity: natural.
    region: int32 from 0. regions: int32 h×w on every `stride`-th pixel of the image, from 1, 0 for none. count: R.
    """

    kind: np.ndarray
    zenith: np.ndarray
    dolp: np.ndarray
    sigma_dolp: np.ndarray
    log_intensity: np.ndarray
    region: np.ndarray
    regions: np.ndarray
    stride: int
    count: int

    def of(self, kind: int, least_share: float, allowed: np.ndarray) -> np.ndarray:
        """Which samples are of this kind, of regions in which a share of at least `least_share` is, and `allowed`."""
        all_samples = np.bincount(self.region, minlength=self.count)
        of_kind = np.bincount(self.region[self.kind == kind], minlength=self.count)
        pure = of_kind >= least_share * np.maximum(all_samples, 1)
        return np.flatnonzero((self.kind == kind) & pure[self.region] & allowed)

    def spread(self, by_region: np.ndarray, elsewhere: float, shape: tuple[int, int]) -> np.ndarray:
        """Values of regions at their pixels, H×W, `elsewhere` where there is no region."""
        coarse = np.concatenate([[elsewhere], by_region]).astype(by_region.dtype)[self.regions]
        fine = np.repeat(np.repeat(coarse, self.stride, axis=0), self.stride, axis=1)
        return np.ascontiguousarray(fine[: shape[0], : shape[1]])


def material_samples(
    image: PolarizationImage,
    normals: np.ndarray,
    camera: PinholeCamera,
    regions: np.ndarray | None = None,
    known: np.ndarray | None = None,
) -> MaterialSamples:
    """Where `image` can be compared with normals.

    normals: float32 H×W×3 in the camera frame, NaN where unknown. regions: integers H×W such as the labels of surfaces,
    which no region crosses; by default regions end where normals turn. known: bool H×W, where normals are measured and
    not only continued from elsewhere; by default everywhere.
    Raises InputError where shapes differ from the camera's.
    """
    for name, array in (("image", image.dolp), ("normals", normals), ("regions", regions), ("known pixels", known)):
        expected = (*camera.shape, 3) if name == "normals" else camera.shape
        if array is not None and array.shape != expected:
            raise InputError(f"materials: {name} {array.shape} do not fit the camera {camera.shape}")
    stride = max(1, round((image.dolp.size / _MOST) ** 0.5))
    every = (slice(None, None, stride), slice(None, None, stride))
    coarse_normals = np.ascontiguousarray(normals[every], np.float32)
    found = smooth_regions(coarse_normals, None if regions is None else regions[every])
    kind, zenith = np.empty(found.shape, np.uint8), np.empty(found.shape, np.float32)
    # copies, since views of one image and another, or none, would be other types, and be compiled for each
    rays, aolp = (np.array(part[every], order="C") for part in (camera.normalized(), image.aolp))
    _compare(coarse_normals, rays, aolp, kind, zenith)
    rho, sigma = image.dolp[every], image.sigma_dolp[every]
    clear = (zenith > _LEAST_ZENITH) & (zenith < _LARGEST_ZENITH) & (found > 0) & image.usable[every]
    if known is not None:
        clear &= known[every]
    clear &= (image.sigma_aolp[every] < _CLEAR_ANGLE) & (rho > _CLEAR_DEGREE * sigma)
    return MaterialSamples(
        kind=kind[clear],
        zenith=zenith[clear],
        dolp=np.sqrt(np.maximum(rho**2 - sigma**2, 0.0))[clear],
        sigma_dolp=sigma[clear],
        log_intensity=np.log(np.maximum(image.intensity[every][clear], 1e-6)),
        region=found[clear] - 1,
        regions=found,
        stride=stride,
        count=int(found.max(initial=0)),
    )


@njit(parallel=True)
def _compare(normals, xy, aolp, kind, zenith):
    """Zenith of normals, and which kind of light would have this angle of polarization."""
    height, width = aolp.shape
    least = np.cos(np.float32(2.0) * _ANGLE_TOLERANCE)
    for v in prange(height):
        for u in range(width):
            x, y, n = xy[v, u, 0], xy[v, u, 1], normals[v, u]
            lengthened = np.float32(1.0) + x * x + y * y
            cosine = -(n[0] * x + n[1] * y + n[2]) / np.sqrt(lengthened)
            zenith[v, u] = np.arccos(min(max(cosine, np.float32(0.0)), np.float32(1.0)))
            dx, dy = n[0] - n[2] * x, n[1] - n[2] * y
            along = (dx * x + dy * y) / lengthened
            cosine, sine = np.cos(aolp[v, u]), np.sin(aolp[v, u])
            diffuse = _agreement(dx, dy, cosine, sine)
            specular = _agreement(dx - x * along, dy - y * along, -sine, cosine)
            kind[v, u] = 0
            if max(diffuse, specular) > least:
                kind[v, u] = DIFFUSE if diffuse > specular else SPECULAR


@njit
def _agreement(dx, dy, cosine, sine):
    """cos 2δ, δ between a direction and an angle."""
    squared = dx * dx + dy * dy
    if not squared > 0:
        return np.float32(0.0)
    dot = dx * cosine + dy * sine
    return np.float32(2.0) * dot * dot / squared - np.float32(1.0)
