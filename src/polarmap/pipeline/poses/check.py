"""Poses that their neighbours contradict: jumps of one pose or a few, and jumps after which all are elsewhere.

A trajectory is split into poses that are kept and poses that are left out, so that as few as possible are left out
and no kept one is reached faster than the camera usually moves there; where very many would have to be left out, it
is broken instead, and what comes after is another piece. Found by dynamic programming over the poses (the cheapest
path through them). Speeds are compared with the trajectory's own, so that its unit and its rate do not matter.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

_FEWEST = 5  # poses from which anything can be said
_AROUND = 30  # steps on either side that say how fast the camera moves here
_FAST = 0.8  # quantile of the speeds that counts as fast here
_FAST_OF_FEW, _FEW = 0.5, 20  # where there are fewer steps, of which a jump is a good part
_SLOWEST = 0.5  # of the same over all, below which it is never taken to be
_TOO_FAST = 5.0  # times that
_LEEWAY = 2.0  # steps that may be missing where some poses are left out
_IN_LINE = 0.25  # of a step's speed, that the one before or after it has in its direction, if it is real motion
_LEAST_TURN = np.radians(1.0)
_ROUNDING = 1e-9  # of coordinates, below which a motion is rounding
_BREAK = 10, 0.5  # poses and seconds, the greater of which are left out before the trajectory is broken


@dataclass(frozen=True, eq=False)
class JudgedPoses:
    """reasons: by pose, why it is left out, "" if it is not. pieces: int N, which piece each belongs to, from 0."""

    reasons: tuple[str, ...]
    pieces: np.ndarray

    @property
    def sound(self) -> bool:
        """Whether no pose is left out, and there is one piece."""
        return not any(self.reasons) and not self.pieces.any()


def judge_poses(timestamps: np.ndarray, poses: np.ndarray) -> JudgedPoses:
    """Judge a trajectory as a whole. timestamps: seconds, increasing, N. poses: T_world_camera, N×4×4."""
    count = len(timestamps)
    if count < _FEWEST:
        return JudgedPoses(("",) * count, np.zeros(count, int))
    motions = _Motion.of(np.asarray(timestamps, np.float64), np.asarray(poses, np.float64))
    if not motions.abrupt.any():
        return JudgedPoses(("",) * count, np.zeros(count, int))
    kept, breaks = _cheapest_path(motions)
    pieces = np.searchsorted(breaks, np.arange(count), side="right")
    return JudgedPoses(tuple(_reasons(motions, kept)), pieces)


@dataclass(frozen=True, eq=False)
class _Motion:
    """Of N poses: times, positions, rotation matrices, usual speed and rate of turning at each, and which of the N-1
    steps are too fast.
    """

    timestamps: np.ndarray
    positions: np.ndarray
    rotations: np.ndarray
    speed: np.ndarray
    turning: np.ndarray
    abrupt: np.ndarray
    rounding: float
    period: float

    @classmethod
    def of(cls, timestamps: np.ndarray, poses: np.ndarray) -> _Motion:
        positions, rotations = poses[:, :3, 3], poses[:, :3, :3]
        periods = np.diff(timestamps)[:, None]
        velocities = np.diff(positions, axis=0) / periods
        turns = Rotation.from_matrix(rotations[:-1].transpose(0, 2, 1) @ rotations[1:]).as_rotvec() / periods
        speed, turning = _usual(velocities), _usual(turns)
        rounding = _ROUNDING * float(np.abs(positions).max())
        abrupt = _is_abrupt(velocities, speed, rounding / periods[:, 0])
        abrupt |= _is_abrupt(turns, turning, _LEAST_TURN / periods[:, 0])
        at_poses = (_at_poses(usual) for usual in (speed, turning))
        return cls(timestamps, positions, rotations, *at_poses, abrupt, rounding, float(np.median(periods)))

    def moved(self, before: np.ndarray, after: int) -> tuple[np.ndarray, np.ndarray]:
        """Distances and angles in radians of some poses from a later one."""
        distances = np.linalg.norm(self.positions[after] - self.positions[before], axis=-1)
        traces = np.einsum("nij,ij->n", self.rotations[before], self.rotations[after])
        return distances, np.arccos(np.clip(0.5 * (traces - 1.0), -1.0, 1.0))

    def jump_text(self, before: int, after: int) -> str:
        """What is too fast between two poses, in words."""
        (distance,), (angle,) = self.moved(np.array([before]), after)
        turned = angle * max(self.speed[after], self.rounding) > distance * max(self.turning[after], _LEAST_TURN)
        return _jump_text(distance, angle, self.timestamps[after] - self.timestamps[before], turned)

    def is_reached(self, before: np.ndarray, after: int) -> np.ndarray:
        """Whether the camera could come from some poses to a later one, about as fast as is usual there."""
        distances, angles = self.moved(before, after)
        periods = self.timestamps[after] - self.timestamps[before] + _LEEWAY * self.period
        speed, turning = (np.maximum(usual[before], usual[after]) for usual in (self.speed, self.turning))
        return (distances <= speed * periods + self.rounding) & (angles <= turning * periods + _LEAST_TURN)


def _usual(velocities: np.ndarray) -> np.ndarray:
    """By step, what is fast around it."""
    speeds = np.linalg.norm(velocities, axis=1)
    quantile = _FAST if len(speeds) >= _FEW else _FAST_OF_FEW
    around = min(_AROUND, len(speeds) - 1)
    padded = np.pad(speeds, around, mode="reflect")
    fast = np.quantile(np.lib.stride_tricks.sliding_window_view(padded, 2 * around + 1), quantile, axis=1)
    return np.maximum(fast, _SLOWEST * np.quantile(speeds, quantile))


def _at_poses(of_steps: np.ndarray) -> np.ndarray:
    return np.maximum(np.append(of_steps, 0.0), np.insert(of_steps, 0, 0.0))


def _is_abrupt(velocities: np.ndarray, usual: np.ndarray, least: np.ndarray) -> np.ndarray:
    """Steps that are too fast, and not in line with the one before or after, as real motion is."""
    speeds = np.linalg.norm(velocities, axis=1)
    along = (velocities[1:] * velocities[:-1]).sum(axis=1)
    with_next, with_last = np.append(along, -1.0), np.insert(along, 0, -1.0)
    in_line = np.maximum(with_next, with_last) >= _IN_LINE * speeds**2
    return (speeds > _TOO_FAST * usual) & (speeds > least) & ~in_line


def _cheapest_path(motions: _Motion) -> tuple[list[int], list[int]]:
    """The poses to keep, and those of them at which a new piece begins; leaving one out costs 1."""
    count = len(motions.timestamps)
    price = max(_BREAK[0], round(_BREAK[1] / motions.period))
    cost, source, broken = np.zeros(count), np.arange(count) - 1, np.zeros(count, bool)
    last_abrupt = -count
    for i in range(1, count):
        last_abrupt = i if motions.abrupt[i - 1] else last_abrupt
        if i - last_abrupt > 2 * price:  # all that could be its source lies in one chain
            cost[i] = cost[i - 1]
            continue
        before = np.arange(max(0, i - 2 * price - 1), i)
        reached = motions.is_reached(before, i)
        reached[-1] = not motions.abrupt[i - 1]
        costs = cost[before] + (i - before - 1) + np.where(reached, 0.0, price)
        best = len(costs) - 1 - int(np.argmin(costs[::-1]))
        cost[i], source[i], broken[i] = min((i, -1, False), (costs[best], before[best], not reached[best]))
    kept = [int(np.argmin(cost + (count - 1 - np.arange(count))))]
    while source[kept[-1]] >= 0:
        kept.append(int(source[kept[-1]]))
    kept.reverse()
    return kept, [i for i in kept if broken[i]]


def _reasons(motions: _Motion, kept: list[int]) -> list[str]:
    """By pose: how it leaves the last one that is kept, or meets the next; of several in a row the one beside it."""
    count = len(motions.timestamps)
    reasons = [""] * count
    left_out = np.ones(count, bool)
    left_out[kept] = False
    for i in np.flatnonzero(left_out):
        following = int(np.searchsorted(kept, i))
        if following == 0:
            reasons[i] = motions.jump_text(kept[0] - 1, kept[0])
        else:
            reasons[i] = reasons[i - 1] or motions.jump_text(kept[following - 1], i)
    return reasons


def _jump_text(distance: float, angle: float, period: float, turned: bool) -> str:
    if turned:
        return f"the pose turns by {np.degrees(angle):.0f} degrees in {period:.2f} s"
    unit, size = next((u for u in (("km", 1e3), ("m", 1.0)) if distance >= u[1]), ("cm", 1e-2))
    return f"the pose jumps by {distance / size:.1f} {unit} in {period:.2f} s"
