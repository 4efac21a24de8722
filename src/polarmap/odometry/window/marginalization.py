"""Marginalization: points and keyframes leave the window, and what they knew stays as a prior (DSO, section 2.3)."""

from __future__ import annotations

import numpy as np

from polarmap.odometry.options import OdometryOptions
from polarmap.odometry.points import ActivePoints
from polarmap.odometry.window.adjustment import brightness_information
from polarmap.odometry.window.residuals import CALIBRATION, FRAME, NONE, linearize
from polarmap.odometry.window.window import KeyframeState, Window

_LEAST_DIAGONAL = 1e-6  # of H, squared grey values, far below any residual's; against division by zero
_LEAST_EIGENVALUE = 1e-12  # of the largest, where H's diagonal is scaled to 1; below it a direction is unknown


def marginalize_points(window: Window, points: ActivePoints, options: OdometryOptions) -> None:
    """Add to the prior what the residuals of `points` say of keyframes and calibration, their depths eliminated.

    The derivatives are those at the first estimate, so that the prior stays consistent with residuals to come.
    """
    if len(points) == 0:
        return
    never = np.full(window.capacity, np.inf, np.float32)
    system = linearize(window.images, points, window.pairs(), never, options.huber, options.gradient_constant)
    H = system.H - system.H_schur
    b = system.b - system.b_schur
    window.prior_H += H
    window.prior_b += b - H @ window.deviation()


def marginalize_keyframe(window: Window, keyframe: KeyframeState, options: OdometryOptions) -> None:
    """Take a keyframe that hosts no more points out of the window; residuals in it are dropped."""
    start = CALIBRATION + FRAME * keyframe.slot
    gone = np.arange(start, start + FRAME)
    window.prior_H, window.prior_b = _with_brightness(window, keyframe, options)
    window.prior_H, window.prior_b = eliminate(window.prior_H, window.prior_b, gone)
    window.keyframes.remove(keyframe)
    window.points.state[:, keyframe.slot] = NONE


def eliminate(H: np.ndarray, b: np.ndarray, gone: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The quadratic x·H x / 2 + b·x minimized over the variables `gone`, whose rows then are zero."""
    kept = np.setdiff1d(np.arange(len(b)), gone)
    scale = 1.0 / np.sqrt(np.diag(H) + _LEAST_DIAGONAL)
    scaled = H * np.outer(scale, scale)
    b_scaled = b * scale
    block = np.linalg.pinv(scaled[np.ix_(gone, gone)], rcond=_LEAST_EIGENVALUE, hermitian=True)
    left = scaled[np.ix_(kept, gone)] @ block
    H_kept = scaled[np.ix_(kept, kept)] - left @ scaled[np.ix_(gone, kept)]
    H_new, b_new = np.zeros_like(H), np.zeros_like(b)
    H_new[np.ix_(kept, kept)] = 0.5 * (H_kept + H_kept.T) / np.outer(scale[kept], scale[kept])
    b_new[kept] = (b_scaled[kept] - left @ b_scaled[gone]) / scale[kept]
    return H_new, b_new


def _with_brightness(window: Window, keyframe: KeyframeState, options: OdometryOptions):
    """The window's prior with the keyframe's own brightness prior."""
    H, b = window.prior_H.copy(), window.prior_b.copy()
    at = CALIBRATION + FRAME * keyframe.slot + 6
    information = brightness_information(options)
    H[[at, at + 1], [at, at + 1]] += information
    b[at : at + 2] += information * keyframe.affine_first
    return H, b
