"""Parameters of the choice of keyframes."""

from __future__ import annotations

from polarmap.options import Options, parameter


class KeyframeOptions(Options):
    """Weights of DSO's rule (`polarmap.odometry.keyframe_rule`): a keyframe is made when w_f f + w_ft f_t + w_a a > 1.

    f is the root mean square optical flow since the last keyframe in pixels of a 640×480 image, f_t the same
    without the rotation, a = |ln(brightness ratio)|.
    """

    flow_weight: float = parameter(
        0.02, "w_f: weight of the flow since the last keyframe", "1/pixel", "III-A", ge=0, le=1000
    )
    translation_weight: float = parameter(
        0.04, "w_ft: weight of the flow without rotation", "1/pixel", "III-A", ge=0, le=1000
    )
    brightness_weight: float = parameter(2.0, "w_a: weight of |ln(brightness ratio)|", source="III-A", ge=0, le=1000)
