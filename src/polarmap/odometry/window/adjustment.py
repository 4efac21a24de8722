"""Adjustment of the window: Gauss-Newton over poses, brightness, calibration and inverse depths (DSO, section 2.3)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from polarmap.odometry.options import OdometryOptions
from polarmap.odometry.pattern import PATTERN_SIZE
from polarmap.odometry.window.residuals import (
    CALIBRATION,
    FRAME,
    GOOD,
    NONE,
    Linearization,
    Pairs,
    Residuals,
    assemble,
    depth_information,
    evaluate,
)
from polarmap.odometry.window.window import KeyframeState, Window

_MIN_INVERSE_DEPTH = 1e-6  # of a mean of about 1; a step that goes below it is not taken

# Levenberg-Marquardt; set by hand. The energy is nearly quadratic where a window starts from, so that damping starts
# low; and it rises fast where a step fails, since each trial costs an evaluation.
_FIRST_DAMPING = 1e-2
_LESS_DAMPING, _MORE_DAMPING = 0.25, 30.0  # factors after a step that is taken, and after one that is not
_LEAST_DAMPING, _LARGEST_DAMPING = 1e-5, 1e4
_SMALL_GAIN = 5e-4  # of the energy, as a share of it; no more steps after one that gains less
_SMALL_STEP = 2e-5  # radians, and lengths where the mean inverse depth is about 1: a hundredth of a pixel and below
_LEAST_DIAGONAL = 1e-8  # of H, squared grey values, far below any residual's; against division by zero
_REGULARIZATION = 1e-10  # of H scaled to a diagonal of 1; decides what no residual does

# A residual is an outlier if its energy over the pattern is above (base + slope · typical root in the frame)², so that
# a blurred frame does not lose all of them (DSO, section 3.2, outlier and occlusion detection; it names no numbers).
_TYPICAL = 0.7  # quantile of the frame's energies
_THRESHOLD_BASE = 13.0  # grey values, root of the sum over the pattern
_THRESHOLD_SLOPE = 0.75

_PRIOR_RESIDUALS = 5000.0  # residuals of one grey value that the brightness prior is worth


@dataclass(frozen=True)
class Adjusted:
    """rms: of the good residuals, in grey values. iterations: that were evaluated."""

    rms: float
    iterations: int


def adjust(window: Window, options: OdometryOptions, iterations: int) -> Adjusted:
    """Minimize the photometric energy of all keyframes and points of the window, with its prior.

    Levenberg-Marquardt: a step that makes the energy larger is taken back and shortened. Residuals that end as
    outliers or outside are dropped.
    """
    damping = _FIRST_DAMPING
    pairs = window.pairs()
    present = _evaluate(window, pairs, options)
    system: Linearization | None = None
    cost = present.energy + _prior_energy(window, options)
    evaluated = 1
    for _ in range(iterations):
        if system is None:
            system = assemble(window.points, pairs, present, options.refine_intrinsics)
        step = _solve(window, system, options, damping)
        saved = _save(window)
        _apply(window, step, system, damping)
        trial_pairs = window.pairs()
        trial = _evaluate(window, trial_pairs, options)
        trial_cost = trial.energy + _prior_energy(window, options)
        evaluated += 1
        if trial_cost <= cost:
            gained = cost - trial_cost
            pairs, present, cost, system = trial_pairs, trial, trial_cost, None
            damping = max(damping * _LESS_DAMPING, _LEAST_DAMPING)
            if _is_small(step, window) or gained < _SMALL_GAIN * cost:
                break
        else:
            _restore(window, saved)
            damping *= _MORE_DAMPING
            if damping > _LARGEST_DAMPING:
                break
    return _conclude(window, pairs, present, evaluated)


def _evaluate(window: Window, pairs: Pairs, options: OdometryOptions) -> Residuals:
    return evaluate(window.images, window.points, pairs, window.thresholds(), options.huber, options.gradient_constant)


def _affine_information(options: OdometryOptions) -> np.ndarray:
    return np.array([options.affine_prior, options.offset_prior]) ** -2.0


def total_prior(window: Window, options: OdometryOptions) -> tuple[np.ndarray, np.ndarray]:
    """H and gradient at the present state of all that is not photometric: what was marginalized, brightness."""
    H = window.prior_H.copy()
    b = window.prior_b + window.prior_H @ window.deviation()
    for keyframe in window.keyframes:
        at = CALIBRATION + FRAME * keyframe.slot + 6
        information = brightness_information(options)
        H[[at, at + 1], [at, at + 1]] += information
        b[at : at + 2] += information * keyframe.affine
    return H, b


def brightness_information(options: OdometryOptions) -> np.ndarray:
    """Information of a and b of a keyframe in units of the photometric energy."""
    return _PRIOR_RESIDUALS * _affine_information(options)


def _prior_energy(window: Window, options: OdometryOptions) -> float:
    x = window.deviation()
    energy = x @ window.prior_H @ x + 2.0 * window.prior_b @ x
    information = brightness_information(options)
    return float(energy + sum(information @ keyframe.affine**2 for keyframe in window.keyframes))


def _free_variables(window: Window, options: OdometryOptions) -> np.ndarray:
    free = [np.arange(CALIBRATION)] if options.refine_intrinsics else []
    for keyframe in window.keyframes:
        start = CALIBRATION + FRAME * keyframe.slot
        free.append(np.arange(start, start + FRAME))
    return np.concatenate(free)


def _solve(window: Window, system: Linearization, options: OdometryOptions, damping: float) -> np.ndarray:
    """The damped step of all variables but the inverse depths, float64 D; zero where a variable is held."""
    prior_H, prior_b = total_prior(window, options)
    H = system.H + prior_H
    H = H + damping * np.diag(np.diag(H)) - system.H_schur / (1.0 + damping)
    b = system.b + prior_b - system.b_schur / (1.0 + damping)
    free = _free_variables(window, options)
    scale = 1.0 / np.sqrt(np.diag(system.H + prior_H)[free] + _LEAST_DIAGONAL)
    scaled = H[np.ix_(free, free)] * np.outer(scale, scale)
    solution = np.linalg.solve(scaled + _REGULARIZATION * np.eye(len(free)), -b[free] * scale)
    step = np.zeros(len(b))
    step[free] = solution * scale
    return step


def _apply(window: Window, step: np.ndarray, system: Linearization, damping: float) -> None:
    window.calibration = window.calibration + step[:CALIBRATION]
    for keyframe in window.keyframes:
        start = CALIBRATION + FRAME * keyframe.slot
        keyframe.step = keyframe.step + step[start : start + 6]
        keyframe.affine = keyframe.affine + step[start + 6 : start + 8]
    points = window.points
    hessian = system.depth_hessian
    change = -(system.depth_gradient + system.coupling @ step.astype(np.float32)) / np.where(hessian > 0, hessian, 1)
    change[hessian <= 0] = 0.0
    change /= 1.0 + damping
    inverse_depth = points.inverse_depth + change
    points.inverse_depth = np.where(inverse_depth > _MIN_INVERSE_DEPTH, inverse_depth, points.inverse_depth).astype(
        np.float32
    )


def _save(window: Window):
    states = [(k, k.step.copy(), k.affine.copy()) for k in window.keyframes]
    return window.calibration.copy(), states, window.points.inverse_depth.copy()


def _restore(window: Window, saved) -> None:
    window.calibration, states, window.points.inverse_depth = saved
    for keyframe, step, affine in states:
        keyframe.step, keyframe.affine = step, affine


def _is_small(step: np.ndarray, window: Window) -> bool:
    poses = step[CALIBRATION:].reshape(-1, FRAME)[:, :6]
    return bool(np.abs(poses).max() < _SMALL_STEP)


def _conclude(window: Window, pairs: Pairs, residuals: Residuals, evaluated: int) -> Adjusted:
    """Take over the residuals' states and the points' information; set the newest keyframe's threshold."""
    points = window.points
    points.information = depth_information(points, pairs, residuals)
    good = residuals.state == GOOD
    points.state = np.where(good, residuals.state, NONE)
    points.good = points.good + good.sum(axis=1, dtype=np.int32)
    set_threshold(window.newest, residuals)
    count = np.count_nonzero(good)
    rms = np.sqrt(residuals.energies[good].sum(dtype=np.float64) / max(count * PATTERN_SIZE, 1))
    return Adjusted(float(rms), evaluated)


def set_threshold(keyframe: KeyframeState, residuals: Residuals) -> None:
    """The energy over which a residual in a keyframe is an outlier, from the distribution of those that it has."""
    energies = residuals.energies[residuals.state[:, keyframe.slot] != NONE, keyframe.slot]
    energies = energies[energies > 0]
    if len(energies):
        typical = np.sqrt(np.quantile(energies, _TYPICAL))
        keyframe.threshold = float((_THRESHOLD_BASE + _THRESHOLD_SLOPE * typical) ** 2)
