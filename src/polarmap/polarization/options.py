"""Parameters of reading polarization."""

from __future__ import annotations

from polarmap.options import Options, parameter


class CueOptions(Options):
    """How cues are read."""

    refractive_index: float = parameter(1.5, "η of surfaces of which nothing is known", source="III-B", ge=1.01, le=9.0)
    estimate_refractive_index: bool = parameter(True, "η is estimated where normals are known and light is of one kind")
    metals: bool = parameter(True, "regions that polarize as metals do get a label and zenith of their own")
    orthographic: bool = parameter(False, "the paper's tan φ = ∇y z/∇x z in place of perspective", source="III-B")
    max_sigma_aolp: float = parameter(0.3, "a noisier angle of polarization is no cue", "rad", ge=1e-3, le=0.89)
    expected_kind: float = parameter(
        0.5, "weight of a network's certain guess of the kind; a clear angle has the sine of its zenith", ge=0, le=100
    )
    vote_radius: int = parameter(
        3, "the kind of reflection is voted on in a square of this radius", "pixels", ge=0, le=100
    )
