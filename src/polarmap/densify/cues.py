"""The cues of a view, with what its surfaces are made of where stereo has points on them."""

from __future__ import annotations

import numpy as np

from polarmap.data.cues import Cues
from polarmap.densify.method import SparseView
from polarmap.materials.estimate import estimate_materials
from polarmap.polarization.cues import disambiguate
from polarmap.polarization.options import CueOptions


def resolved_cues(sparse: SparseView, normals: np.ndarray, options: CueOptions) -> Cues:
    """Polarization of the view, its ambiguities resolved by normals, float32 H×W×3 with NaN."""
    image, camera = sparse.view.image, sparse.camera
    materials = estimate_materials(image, normals, camera, None, options, np.isfinite(sparse.points))
    prediction = sparse.prior.prediction
    specular = None if prediction is None else prediction.specular
    return disambiguate(image, normals, camera, options, materials.eta, materials.metal, specular)
