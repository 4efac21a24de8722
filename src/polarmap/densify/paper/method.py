"""The paper's loop (Section III-D) as a `Densifier`."""

from __future__ import annotations

import numpy as np

from polarmap.data.keyframe import CueBeliefs
from polarmap.densify.cues import resolved_cues
from polarmap.densify.method import Densified, SparseView
from polarmap.densify.options import PaperOptions
from polarmap.densify.paper.guidance import guide, plane_gradient
from polarmap.densify.paper.loop import densify
from polarmap.geometry.surface import normals_from_depth
from polarmap.polarization.options import CueOptions
from polarmap.timing import StepClock


class ByThePaper:
    """The paper's loop, guided by the cues, whose ambiguities the prior resolves."""

    def __init__(self, options: PaperOptions | None = None, cues: CueOptions | None = None) -> None:
        self.options = options or PaperOptions()
        self.cues = cues or CueOptions()

    def __call__(self, sparse: SparseView, clock: StepClock) -> Densified:
        """See `Densifier`."""
        prior, camera = sparse.prior, sparse.camera
        with clock("cues"):
            cues = resolved_cues(sparse, normals_from_depth(prior.depth, camera), self.cues)
        with clock("densify"):
            guidance = guide(prior.depth, cues, _slopes(sparse), camera, self.cues.orthographic)
            stable = sparse.view.image.stable
            dense = densify(sparse.points, guidance.gradient, stable, sparse.neighbours, camera, self.options)
        return Densified(dense, cues, CueBeliefs(guidance.diffuse, guidance.specular))


def _slopes(sparse: SparseView) -> np.ndarray:
    """Gradient of log range of the stereo planes, float32 H×W×2, NaN where the point is no inlier."""
    planes = sparse.planes
    slopes = plane_gradient(planes.inverse_depth, planes.gradient_u, planes.gradient_v, sparse.camera)
    slopes[np.isnan(sparse.points)] = np.nan
    return slopes
