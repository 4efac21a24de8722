"""A local origin for worlds of large coordinates, such as UTM, so that single precision holds what is in them."""

from __future__ import annotations

import numpy as np

FAR = 1000.0
"""From here on coordinates are counted from a local origin: single precision has steps of 0.06 mm there."""

LARGEST_STEP = 1e-3
"""Coordinates whose steps are larger hold no surface any more, metres (or units of the poses)."""

_ROUND = 100.0  # that a local origin is a multiple of, so that people can read it and single precision holds it
_LEAST_VALUES = 3  # different ones that tell steps
_FEW = 4.0  # steps that rounded motion usually is of
_RESTING = 0.2  # share of the motions that rounding makes none of
_DECIMALS = (1000.0, 100.0, 10.0, 1.0, 0.1, 0.01)
_ROUNDING = 4.0  # of double precision's steps, that written multiples may be off


def local_origin(position: np.ndarray) -> np.ndarray:
    """The origin to count coordinates around a position (3,) from, float64 (3,).

    Zero where all three are within 1000 of zero; else the position rounded to whole hundreds.
    """
    position = np.asarray(position, float)
    if np.abs(position).max() < FAR:
        return np.zeros(3)
    return _ROUND * np.round(position / _ROUND) + 0.0  # no negative zero


def shifted(T: np.ndarray, shift: np.ndarray) -> np.ndarray:
    """A motion 4×4 into a world whose coordinates are larger by `shift` (3,); `T` itself where that is zero."""
    if not np.any(shift):
        return T
    moved = np.array(T, np.float64)
    moved[..., :3, 3] += shift
    return moved


def steps_of(values: np.ndarray) -> float:
    """The distance between neighbouring numbers of the type of `values` at the largest of them; 0 without any."""
    finite = np.abs(values[np.isfinite(values)])
    return float(np.spacing(finite.max())) if finite.size else 0.0


def lost_precision(positions: np.ndarray) -> float:
    """The step that a trajectory was rounded to, by single precision or by too few digits; 0 where it was not.

    positions: float64 N×3, in the order of time. Rounded means: along an axis on which they are far from zero, all are
    whole multiples of a step of more than 1 mm, which is as large as the motion from one to the next.
    """
    return max((_lost_along(axis[np.isfinite(axis)]) for axis in np.asarray(positions, float).T), default=0.0)


def _lost_along(values: np.ndarray) -> float:
    if len(np.unique(values)) < _LEAST_VALUES or np.abs(values).max() < FAR:
        return 0.0
    moves = np.abs(np.diff(values))
    usual, resting = float(np.median(moves[moves > 0])), float(np.mean(moves == 0))
    single = float(np.spacing(np.float32(min(np.abs(values).max(), 1e38))))
    for step in sorted((single, *_DECIMALS), reverse=True):
        if step > LARGEST_STEP and usual < _FEW * step and _are_multiples(values, step):
            fractions = step == single and not _are_multiples(values, 1.0)
            return step if fractions or resting > _RESTING else 0.0
    return 0.0


def _are_multiples(values: np.ndarray, step: float) -> bool:
    off = np.abs(values - step * np.round(values / step))
    return bool((off <= _ROUNDING * np.spacing(np.abs(values))).all())
