"""Parameters of the odometry."""

from __future__ import annotations

from polarmap.options import Options, parameter

_DSO = "III-A"


class OdometryOptions(Options):
    """Parameters of direct sparse odometry; lengths in pixels are for a 640×480 image and scale with it."""

    points: int = parameter(2000, "active points that adjustment aims at", source=_DSO, ge=200, le=20000)
    candidates: int = parameter(1500, "candidate points chosen in each keyframe", source=_DSO, ge=200, le=20000)
    keyframes: int = parameter(7, "keyframes adjusted together", source=_DSO, ge=4, le=12)
    iterations: int = parameter(6, "most iterations of an adjustment", source=_DSO, ge=1, le=50)
    flow_weight: float = parameter(0.02, "w_f of the keyframe rule: flow since the last one", "1/pixel", _DSO, ge=0,
                                le=1000)  # fmt: skip
    translation_weight: float = parameter(0.04, "w_ft of the keyframe rule: the same without rotation", "1/pixel",
                                          _DSO, ge=0, le=1000)  # fmt: skip
    brightness_weight: float = parameter(2.0, "w_a of the keyframe rule: |ln(brightness ratio)|", source=_DSO, ge=0,
                                      le=1000)  # fmt: skip
    huber: float = parameter(9.0, "where residuals turn from squared to linear", "grey value of 255", _DSO, ge=0.01,
                          le=20)  # fmt: skip
    gradient_constant: float = parameter(50.0, "c of the weight c²/(c²+|∇I|²)", "grey value of 255", _DSO, ge=0.01,
                                      le=1e4)  # fmt: skip
    gradient_threshold: float = parameter(7.0, "gradient above a block's median that makes a candidate",
                                          "grey value of 255", _DSO, ge=0.01, le=255)  # fmt: skip
    search_length: float = parameter(30.0, "longest search along an epipolar line", "pixel", ge=3, le=1000)
    affine_prior: float = parameter(0.1, "standard deviation of a keyframe's ln(brightness)", ge=1e-4, le=100)
    offset_prior: float = parameter(0.5, "standard deviation of a keyframe's brightness offset",
                                    "grey value of 255", ge=1e-3, le=1000)  # fmt: skip
    refine_intrinsics: bool = parameter(False, "adjust fx, fy, cx and cy too")
