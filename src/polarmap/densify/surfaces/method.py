"""Densification by the surfaces that explain a view, as a `Densifier`."""

from __future__ import annotations

import numpy as np

from polarmap.data.keyframe import CueBeliefs
from polarmap.densify.cues import resolved_cues
from polarmap.densify.method import Densified, SparseView
from polarmap.densify.options import SurfaceOptions
from polarmap.densify.surfaces.expected import Expected
from polarmap.densify.surfaces.find import find_surfaces
from polarmap.polarization.options import CueOptions
from polarmap.timing import StepClock


class BySurfaces:
    """Planes and free surfaces; the ambiguities of polarization are resolved by the depth that comes out."""

    def __init__(self, options: SurfaceOptions | None = None, cues: CueOptions | None = None) -> None:
        self.options = options or SurfaceOptions()
        self.cues = cues or CueOptions()

    def __call__(self, sparse: SparseView, clock: StepClock) -> Densified:
        """See `Densifier`."""
        prior, image = sparse.prior, sparse.view.image
        with clock("densify"):
            free = [prior.depth] if prior.by_points is None else [prior.depth, prior.by_points]
            surfaces = find_surfaces(
                sparse.points,
                free,
                image,
                image.stable,
                sparse.camera,
                sparse.neighbours,
                self.options,
                Expected.of(prior),
                sparse.known_planes,
                sparse.planes.window,
                sparse.sightings,
                _point_sigma(sparse),
            )
        with clock("cues"):
            cues = resolved_cues(sparse, surfaces.dense.normal, self.cues)
        beliefs = CueBeliefs(surfaces=surfaces.polarization_weight)
        return Densified(surfaces.dense, cues, beliefs, surfaces.lasting)


def _point_sigma(sparse: SparseView) -> float:
    """Relative standard deviation of the depth of points by noise, their median."""
    sigma = (sparse.planes.sigma * sparse.points)[sparse.points > 0]
    return float(np.median(sigma)) if sigma.size else 0.0
