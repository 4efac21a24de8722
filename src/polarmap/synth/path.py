"""Camera paths: a smooth hand-held motion, or an arc about a thing; the same for the same seed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from polarmap.errors import InputError
from polarmap.geometry.pose import look_at

_LEAST_SPEED = 0.6  # of a loop with its sway, as a share of its mean half axis per radian
_MEAN_HALF_AXIS = 0.85  # metres, of the loop for which the frequencies of the wandering are given
_PHASE_STEP = 0.002  # radians, between which the path is taken as straight
_AT_ONCE = 100_000  # such steps, so that long paths need little memory
_MOST_ROUNDS = 10_000
_ROLL = np.radians(1.5)  # rms


@dataclass(frozen=True)
class Loop:
    """A level ellipse that a camera goes round, begun near its rear end, so that a path of any length stays near.

    sideways, forward: half axes in metres; it reaches `sideways` to either side of its middle and goes 2·`forward`
        ahead before it comes back. A narrow one is a way out and back.
    first_angle: where on the ellipse it begins, radians; 0 is the rear end, from where it goes straight to the right.
    sway: metres rms about the ellipse. gaze_drift: rms, as a share of the distance to the target.
    follow: share of the camera's own motion that the target goes along with.
    """

    sideways: float = 1.2
    forward: float = 0.5
    first_angle: float = 0.15
    sway: float = 0.02
    gaze_drift: float = 0.05
    follow: float = 0.0

    def __post_init__(self) -> None:
        if not (self.sideways > 0 and self.forward > 0):
            raise InputError("hand-held path: the half axes of a loop must be positive")

    @property
    def mean_half_axis(self) -> float:
        """Half the sum of both, metres."""
        return (self.sideways + self.forward) / 2


@dataclass(frozen=True)
class Arc:
    """A level arc about a target, which all views look at: a camera that converges on things, from far apart.

    It goes to and fro, so that a path of any length stays on it.

    eye: the middle of the arc, world, metres. target: world, metres; the arc's centre is above or below it.
    angle: from one end to the other, degrees, in (0, 360].
    step: metres a frame, where a path names none. fov: horizontal field of view that suits it, degrees.
    sway: metres rms about the arc. gaze_drift: rms, as a share of the distance to the target.
    """

    eye: tuple[float, float, float]
    target: tuple[float, float, float]
    angle: float = 90.0
    step: float = 0.08
    fov: float = 40.0
    sway: float = 0.01
    gaze_drift: float = 0.02

    def __post_init__(self) -> None:
        if not 0.0 < self.angle <= 360.0:
            raise InputError(f"arc: its angle must be over 0 and at most 360 degrees, not {self.angle}")


_STEPS = (1e-9, 1e12)  # metres a frame
_RATES = (1e-3, 1e6)  # frames a second


def handheld_path(
    eye: tuple[float, float, float],
    target: tuple[float, float, float],
    up: tuple[float, float, float] = (0.0, 0.0, 1.0),
    frames: int = 24,
    step: float = 0.04,
    frame_rate: float = 30.0,
    seed: int = 0,
    loop: Loop = Loop(),
) -> tuple[np.ndarray, np.ndarray]:
    """Timestamps (s, float64 N) and T_world_camera (float64 N×4×4) of a hand-held camera.

    The camera starts at `eye` and looks at `target`; it moves `step` metres a frame along a `Loop` (2.4 m by 1 m where
    none is given) that begins to the right and a little forward, sways by centimetres, rolls by degrees, and its gaze
    drifts about the target.
    Raises InputError where frames, step or frame_rate is not positive or absurd, or the path is longer than some ten
    thousand rounds of the loop.
    """
    _check("hand-held path", frames, step, frame_rate)
    start = look_at(eye, target, up)
    phase = _phase_at(step * np.arange(frames), loop, seed)
    distance = np.linalg.norm(np.subtract(target, eye))
    offset = _offset(phase, loop, seed)
    drift = loop.gaze_drift * distance * _wander(_pace(loop) * phase, 3, seed + 1) + loop.follow * offset
    eyes = np.asarray(eye) + offset @ start[:3, :3].T
    targets = np.asarray(target) + drift @ start[:3, :3].T
    rolls = _ROLL * _wander(_pace(loop) * phase, 1, seed + 2)[:, 0]
    return np.arange(frames) / frame_rate, _poses(eyes, targets, up, rolls)


def arc_path(
    arc: Arc,
    up: tuple[float, float, float] = (0.0, 0.0, 1.0),
    frames: int = 24,
    step: float | None = None,
    frame_rate: float = 30.0,
    seed: int = 0,
) -> tuple[np.ndarray, np.ndarray]:
    """Timestamps (s, float64 N) and T_world_camera (float64 N×4×4) of a camera that goes to and fro on an arc.

    It starts at the arc's left end, as seen from its middle, and moves `step` metres a frame along it, the arc's own
    where None; it sways, rolls by degrees, and its gaze drifts about the target.
    Raises InputError where frames, step or frame_rate is not positive or absurd, or the arc's eye is above its target.
    """
    step = arc.step if step is None else step
    _check("arc", frames, step, frame_rate)
    axis = np.asarray(up, float) / np.linalg.norm(up)
    from_target = np.subtract(arc.eye, arc.target)
    level = from_target - axis * (axis @ from_target)
    radius = float(np.linalg.norm(level))
    if radius < 1e-6:
        raise InputError("arc: its eye is straight above or below its target")
    length = step * np.arange(frames)
    turn = _to_and_fro(length / radius, np.radians(arc.angle))[:, None]
    circle = np.cos(turn) * level + np.sin(turn) * np.cross(axis, level) + (from_target - level)
    pace = length / _MEAN_HALF_AXIS
    eyes = np.asarray(arc.target) + circle + arc.sway * _wander(pace, 3, seed)
    drift = arc.gaze_drift * np.linalg.norm(from_target) * _wander(pace, 3, seed + 1)
    rolls = _ROLL * _wander(pace, 1, seed + 2)[:, 0]
    return np.arange(frames) / frame_rate, _poses(eyes, np.asarray(arc.target) + drift, up, rolls)


def _to_and_fro(turned: np.ndarray, whole: float) -> np.ndarray:
    """Angle on an arc of `whole` radians about its middle, after turning by so much from its left end."""
    folded = turned % (2.0 * whole)
    return np.minimum(folded, 2.0 * whole - folded) - whole / 2


def _check(what: str, frames: int, step: float, frame_rate: float) -> None:
    if frames < 1 or not 0 < step < np.inf or not 0 < frame_rate < np.inf:
        raise InputError(f"{what}: frames, step and frame_rate must be positive")
    for name, value, (least, most) in (("step", step, _STEPS), ("frame_rate", frame_rate, _RATES)):
        if not least <= value <= most:
            raise InputError(f"{what}: {name} must be {least:g} to {most:g}, not {value:g}")


def _poses(eyes: np.ndarray, targets: np.ndarray, up: tuple[float, float, float], rolls: np.ndarray) -> np.ndarray:
    """T_world_camera, N×4×4, of cameras that look at targets, each rolled about its own axis."""
    return np.stack([look_at(e, t, up) @ _rolled(roll) for e, t, roll in zip(eyes, targets, rolls, strict=True)])


def _offset(phase: np.ndarray, loop: Loop, seed: int) -> np.ndarray:
    """Position relative to the start, N×3, in the axes of a camera that looks at the target from there."""
    right = loop.sideways * (np.sin(loop.first_angle + phase) - np.sin(loop.first_angle))
    forward = loop.forward * (np.cos(loop.first_angle) - np.cos(loop.first_angle + phase))
    ellipse = np.stack([right, np.zeros_like(phase), forward], axis=1)
    return ellipse + loop.sway * _wander(_pace(loop) * phase, 3, seed)


def _phase_at(length: np.ndarray, loop: Loop, seed: int) -> np.ndarray:
    """Angle on the loop after each path length in metres, so that the camera keeps its speed."""
    last = length[-1] / (_LEAST_SPEED * loop.mean_half_axis) + 2.0 * np.pi
    if last > _MOST_ROUNDS * 2.0 * np.pi:
        raise InputError(f"hand-held path: {length[-1]:.0f} m are too many rounds of the loop; take fewer frames")
    phase = np.arange(0.0, last, _PHASE_STEP)
    parts = [phase[i : i + _AT_ONCE + 1] for i in range(0, len(phase) - 1, _AT_ONCE)]
    steps = [np.linalg.norm(np.diff(_offset(part, loop, seed), axis=0), axis=1) for part in parts]
    return np.interp(length, np.concatenate([[0.0], np.cumsum(np.concatenate(steps))]), phase)


def _pace(loop: Loop) -> float:
    """What an angle on a loop is multiplied with, so that wandering is alike per metre of path."""
    return loop.mean_half_axis / _MEAN_HALF_AXIS


def _wander(angle: np.ndarray, columns: int, seed: int) -> np.ndarray:
    """Smooth random curves of unit rms that start at 0, N×columns: three sinusoids each."""
    rng = np.random.default_rng(seed)
    frequency = rng.uniform([1.0, 2.0, 3.0], [2.0, 3.0, 5.0], (columns, 3))
    shift = rng.uniform(0.0, 2.0 * np.pi, (columns, 3))
    turned = angle[:, None, None] * frequency + shift
    amplitude = np.sqrt(2.0) * np.array([0.8, 0.5, 0.33])
    return ((np.sin(turned) - np.sin(shift)) * amplitude).sum(axis=2)


def _rolled(angle: float) -> np.ndarray:
    """T of a camera turned about its own viewing axis."""
    T = np.eye(4)
    T[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    return T
