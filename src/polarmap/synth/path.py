"""Camera paths: a smooth hand-held motion, the same for the same seed."""

from __future__ import annotations

import numpy as np

from polarmap.errors import InputError
from polarmap.geometry.pose import look_at

_SIDEWAYS, _FORWARD = 1.2, 0.5  # half axes of the loop, metres
_FIRST_ANGLE = 0.15  # on the loop, radians: to the right and a little forward
_LEAST_SPEED = 0.3  # of the loop with its sway, metres per radian
_SWAY = 0.02  # metres rms
_ROLL = np.radians(1.5)  # rms
_GAZE_DRIFT = 0.05  # rms, as a share of the distance to the target


def handheld_path(
    eye: tuple[float, float, float],
    target: tuple[float, float, float],
    up: tuple[float, float, float] = (0.0, 0.0, 1.0),
    frames: int = 24,
    step: float = 0.04,
    frame_rate: float = 30.0,
    seed: int = 0,
) -> tuple[np.ndarray, np.ndarray]:
    """Timestamps (s, float64 N) and T_world_camera (float64 N×4×4) of a hand-held camera.

    The camera starts at `eye` and looks at `target`; it moves `step` metres a frame along a loop that begins to the
    right and a little forward (an ellipse of 2.4 m by 1 m, so that a path of any length stays near), sways by
    centimetres, rolls by degrees, and its gaze drifts about the target.
    Raises InputError where frames, step or frame_rate is not positive.
    """
    if frames < 1 or not step > 0 or not frame_rate > 0:
        raise InputError("hand-held path: frames, step and frame_rate must be positive")
    start = look_at(eye, target, up)
    phase = _phase_at(step * np.arange(frames), seed)
    drift = _GAZE_DRIFT * np.linalg.norm(np.subtract(target, eye)) * _wander(phase, 3, seed + 1)
    eyes = np.asarray(eye) + _offset(phase, seed) @ start[:3, :3].T
    targets = np.asarray(target) + drift @ start[:3, :3].T
    rolls = _ROLL * _wander(phase, 1, seed + 2)[:, 0]
    poses = [look_at(e, t, up) @ _rolled(roll) for e, t, roll in zip(eyes, targets, rolls, strict=True)]
    return np.arange(frames) / frame_rate, np.stack(poses)


def _offset(phase: np.ndarray, seed: int) -> np.ndarray:
    """Position relative to the start, N×3, in the axes of a camera that looks at the target from there."""
    right = _SIDEWAYS * (np.sin(_FIRST_ANGLE + phase) - np.sin(_FIRST_ANGLE))
    forward = _FORWARD * (np.cos(_FIRST_ANGLE) - np.cos(_FIRST_ANGLE + phase))
    return np.stack([right, np.zeros_like(phase), forward], axis=1) + _SWAY * _wander(phase, 3, seed)


def _phase_at(length: np.ndarray, seed: int) -> np.ndarray:
    """Angle on the loop after each path length in metres, so that the camera keeps its speed."""
    phase = np.arange(0.0, length[-1] / _LEAST_SPEED + 0.1, 0.002)
    steps = np.linalg.norm(np.diff(_offset(phase, seed), axis=0), axis=1)
    return np.interp(length, np.concatenate([[0.0], np.cumsum(steps)]), phase)


def _wander(phase: np.ndarray, columns: int, seed: int) -> np.ndarray:
    """Smooth random curves of unit rms that start at 0, N×columns: three sinusoids each."""
    rng = np.random.default_rng(seed)
    frequency = rng.uniform([1.0, 2.0, 3.0], [2.0, 3.0, 5.0], (columns, 3))
    shift = rng.uniform(0.0, 2.0 * np.pi, (columns, 3))
    angle = phase[:, None, None] * frequency + shift
    amplitude = np.sqrt(2.0) * np.array([0.8, 0.5, 0.33])
    return ((np.sin(angle) - np.sin(shift)) * amplitude).sum(axis=2)


def _rolled(angle: float) -> np.ndarray:
    """T of a camera turned about its own viewing axis."""
    T = np.eye(4)
    T[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    return T
