"""What surfaces are made of, as far as polarization and known normals tell: refractive index and metals."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from polarmap.data.polarization_image import PolarizationImage
from polarmap.geometry.camera import PinholeCamera
from polarmap.materials.metal_regions import metals_of
from polarmap.materials.refractive_index import refractive_index_of
from polarmap.materials.samples import material_samples
from polarmap.polarization.options import CueOptions


@dataclass(frozen=True)
class Materials:
    """Of every pixel, or None where the options do not ask for it.

    eta: float32 H×W, see `estimate_refractive_index`. metal: uint8 H×W, see `find_metals`.
    """

    eta: np.ndarray | None = None
    metal: np.ndarray | None = None


def estimate_materials(
    image: PolarizationImage,
    normals: np.ndarray,
    camera: PinholeCamera,
    regions: np.ndarray | None = None,
    options: CueOptions | None = None,
    known: np.ndarray | None = None,
) -> Materials:
    """Both estimates from the same samples; arguments as of `estimate_refractive_index`."""
    options = options or CueOptions()
    if options.orthographic or not (options.estimate_refractive_index or options.metals):
        return Materials()
    samples = material_samples(image, normals, camera, regions, known)
    return Materials(
        eta=refractive_index_of(samples, camera.shape, options.refractive_index)
        if options.estimate_refractive_index
        else None,
        metal=metals_of(samples, camera.shape) if options.metals else None,
    )
