"""Whether given poses fit the pictures, and which usual mistake would explain it where they do not.

Corners are followed over a few frames, at places spread over the sequence. Where the poses are right, the matches lie
on the epipolar lines that follow from them; a pose that is inverted, turned to other axes, or of another time puts them
elsewhere. Each such mistake is undone in turn, and the one that brings the matches back is named.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache
from itertools import permutations, product
from typing import TYPE_CHECKING

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from polarmap.errors import InputError
from polarmap.geometry.camera import PinholeCamera
from polarmap.geometry.pose import inverse

if TYPE_CHECKING:
    from polarmap.data.frame import Frame

_PLACES = 8  # at which corners are followed
_MOST_STEPS = 8  # frames over which they are
_ENOUGH_FLOW = 0.025  # of the image width
_CORNERS = 200
_MIN_MATCHES = 20
_MIN_PAIRS = 3
_EXACT = 0.25  # pixels of an image 640 wide: nearer to the lines than this, no other reading is asked for
_TOLERANCE = 1.5  # likewise: matches of poses that are right, if noisy, are nearer
_BETTER = 0.4  # of the distance as given, below which another reading of the poses is believed
_IN_FRONT = 0.6  # of the matches that must lie before both cameras
_SHIFTS = 0.02 * np.arange(-30, 31)  # seconds
_FINE_SHIFTS = 0.005 * np.arange(-3, 4)  # about the best of those
_LEAST_SHIFT = 0.015  # smaller ones are left alone
_FOCAL_FACTORS = (0.5, 0.6, 0.7, 0.8, 1.25, 1.4, 1.6, 2.0)


@dataclass(frozen=True, eq=False)
class Matches:
    """Corners of one frame and where they are in a later one.

    before, after: float64 N×2, (u, v) in pixels of the undistorted image. times: of both frames, seconds.
    """

    before: np.ndarray
    after: np.ndarray
    times: tuple[float, float]


@dataclass(frozen=True)
class PoseFit:
    """distance: median distance of the matches from their epipolar lines in pixels, with the poses as given; infinite
    where most matches would lie behind a camera. tolerance: up to which poses can be right.

    reading: a phrase that says how else the poses would explain the pictures much better; empty where there is none.
    corrected: the distance then.
    """

    distance: float
    tolerance: float
    reading: str = ""
    corrected: float = float("nan")

    @property
    def fits(self) -> bool:
        """Whether the poses as given explain the pictures, and no other reading does so much better."""
        return self.distance <= self.tolerance and not self.reading


PoseAt = Callable[[float], np.ndarray | None]
"""Gives T_world_camera, float64 4×4, at a timestamp in seconds, None where it is not known."""


def fit_of_poses(
    frames: Callable[[int], Frame],
    grey: Callable[[Frame], np.ndarray],
    timestamps: np.ndarray,
    pose_at: PoseAt,
    camera: PinholeCamera,
) -> PoseFit | None:
    """How well the poses fit a sequence; None where too little can be followed, or the camera hardly moves.

    frames: the frame at a position of `timestamps` (seconds, float64 N). grey: its undistorted image, float32 H×W in
    [0, 1], of `camera`. Frames that cannot be read are left out.
    """
    posed = [i for i, t in enumerate(timestamps) if pose_at(t) is not None]
    matches = list(_all_matches(frames, grey, timestamps, posed))
    return judge(matches, pose_at, camera)


def judge(matches: list[Matches], pose_at: PoseAt, camera: PinholeCamera) -> PoseFit | None:
    """How well the poses fit these matches; None where there are too few or the camera hardly moves."""
    pixel = camera.width / 640
    given = _distance(matches, pose_at, camera)
    if given is None:
        return None
    if given <= _EXACT * pixel:
        return PoseFit(given, _TOLERANCE * pixel)
    found = [_best_shift(matches, pose_at, camera)]
    found += [(name, _distance(matches, at, seen_by)) for name, at, seen_by in _readings(cache(pose_at), camera)]
    known = [(name, distance) for name, distance in found if distance is not None]
    reading, corrected = min(known, key=lambda item: item[1], default=("", np.inf))
    if corrected <= _TOLERANCE * pixel and corrected < _BETTER * given:
        return PoseFit(given, _TOLERANCE * pixel, reading, corrected)
    return PoseFit(given, _TOLERANCE * pixel)


def _all_matches(frames, grey, timestamps: np.ndarray, posed: list[int]) -> Iterator[Matches]:
    if len(posed) < 2:
        return
    starts = np.unique(np.linspace(0, len(posed) - 2, _PLACES).round().astype(int))
    for start in starts:
        try:
            found = _follow(frames, grey, posed[start : start + 1 + _MOST_STEPS])
        except InputError:  # the mapping has told
            continue
        if found is not None:
            before, after, last = found
            yield Matches(before, after, (float(timestamps[posed[start]]), float(timestamps[last])))


def _follow(frames, grey, positions: list[int]) -> tuple[np.ndarray, np.ndarray, int] | None:
    """Corners of the first frame and where they are in a later one, at the latest the last; None if too few are."""
    image = _bytes(grey(frames(positions[0])))
    corners = cv2.goodFeaturesToTrack(image, _CORNERS, 0.01, 10)
    if corners is None:
        return None
    before, now, last = corners, corners, positions[0]
    for position in positions[1:]:
        following = _bytes(grey(frames(position)))
        now, kept = _track(image, following, now)
        before, now, image, last = before[kept], now[kept], following, position
        if len(now) < _MIN_MATCHES:
            return None
        flow = np.median(np.linalg.norm(now - before, axis=-1))
        if flow > _ENOUGH_FLOW * image.shape[1]:
            break
    return before[:, 0].astype(np.float64), now[:, 0].astype(np.float64), last


def _track(image: np.ndarray, following: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where points are in the following image, and which of them come back to where they were."""
    window = {"winSize": (15, 15), "maxLevel": 4}
    found, status, _ = cv2.calcOpticalFlowPyrLK(image, following, points, None, **window)
    back, status_back, _ = cv2.calcOpticalFlowPyrLK(following, image, found, None, **window)
    near = np.linalg.norm(back - points, axis=-1).ravel() < 0.5
    return found, (status.ravel() == 1) & (status_back.ravel() == 1) & near


def _bytes(grey: np.ndarray) -> np.ndarray:
    """Display levels: square root of intensity, up to its brightest percent."""
    white = max(float(np.percentile(grey, 99)), 1e-6)
    return np.uint8(np.clip(255 * np.sqrt(grey / white), 0, 255))


def _distance(matches: list[Matches], pose_at: PoseAt, camera: PinholeCamera) -> float | None:
    """Median distance in pixels of the matches from their epipolar lines; None where fewer than three pairs tell.

    Infinite where most of them would lie behind a camera.
    """
    medians, in_front = [], []
    motions = [_motion(pair, pose_at) for pair in matches]
    longest = max((np.linalg.norm(T[:3, 3]) for T in motions if T is not None), default=0.0)
    for pair, T in zip(matches, motions, strict=True):
        if T is None or not np.linalg.norm(T[:3, 3]) > 0.02 * longest:
            continue
        distances, ahead = _from_lines(_rays(pair.before, camera), _rays(pair.after, camera), T)
        medians.append(np.median(distances) * camera.fx)
        in_front.append(np.mean(ahead))
    if len(medians) < min(_MIN_PAIRS, len(matches)) or not medians:
        return None
    return float(np.median(medians)) if np.median(in_front) >= _IN_FRONT else float("inf")


def _motion(pair: Matches, pose_at: PoseAt) -> np.ndarray | None:
    """T_after_before, float64 4×4."""
    first, second = (pose_at(t) for t in pair.times)
    return None if first is None or second is None else inverse(second) @ first


def _rays(pixels: np.ndarray, camera: PinholeCamera) -> np.ndarray:
    x, y = (pixels[:, 0] - camera.cx) / camera.fx, (pixels[:, 1] - camera.cy) / camera.fy
    return np.stack([x, y, np.ones(len(pixels))], axis=1)


def _from_lines(before: np.ndarray, after: np.ndarray, T: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Sampson's distance of matches from the epipolar geometry of T_after_before, and which are before both cameras.

    before, after: rays N×3 with z = 1; the distance is in their unit.
    """
    R, t = T[:3, :3], T[:3, 3] / np.linalg.norm(T[:3, 3])
    E = np.cross(np.eye(3), t) @ R  # any sign
    line_after, line_before = before @ E.T, after @ E
    length = np.sqrt((line_after[:, :2] ** 2).sum(1) + (line_before[:, :2] ** 2).sum(1))
    distance = np.abs((after * line_after).sum(1)) / np.maximum(length, 1e-12)
    turned = before @ R.T
    # z_after · after = z_before · turned + t, solved for both depths by cross products
    normal = np.cross(after, turned)
    size = np.maximum((normal**2).sum(1), 1e-18)
    z_before = -(np.cross(after, t) * normal).sum(1) / size
    z_after = -(np.cross(turned, t) * normal).sum(1) / size
    return distance, (z_before > 0) & (z_after > 0)


def _readings(pose_at: PoseAt, camera: PinholeCamera) -> Iterator[tuple[str, PoseAt, PinholeCamera]]:
    """Other ways to read the poses and the camera, each with the phrase that names the mistake."""
    for turn_name, turn in _turns():
        for base_name, base in _BASES.items():
            name = " with ".join(filter(None, (base_name, turn_name)))
            if name:
                yield f"when taken as {name}", _changed(pose_at, base, turn), camera
    for factor in _FOCAL_FACTORS:
        wider = PinholeCamera(camera.width, camera.height, factor * camera.fx, factor * camera.fy, camera.cx, camera.cy)
        yield f"with {factor:g} times the focal length of the camera file", pose_at, wider


def _changed(pose_at: PoseAt, base: Callable, turn: np.ndarray) -> PoseAt:
    def at(timestamp: float) -> np.ndarray | None:
        T = pose_at(timestamp)
        if T is None:
            return None
        T = base(T)
        return T @ turn

    return at


def _transposed_rotation(T: np.ndarray) -> np.ndarray:
    changed = T.copy()
    changed[:3, :3] = T[:3, :3].T
    return changed


def _other_quaternion_order(T: np.ndarray) -> np.ndarray:
    """As if x, y, z, w had been read where w, x, y, z was written, or the other way round: the former undone."""
    x, y, z, w = Rotation.from_matrix(T[:3, :3]).as_quat()
    changed = T.copy()
    changed[:3, :3] = Rotation.from_quat([y, z, w, x]).as_matrix()
    return changed


_BASES: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "": lambda T: T,
    "world-to-camera poses": inverse,
    "poses whose rotation is world-to-camera": _transposed_rotation,
    "poses whose quaternion begins with w": _other_quaternion_order,
}


_KNOWN_TURNS = {
    ((1, 0, 0), (0, -1, 0), (0, 0, -1)): "OpenGL's camera axes (y up, z backward)",
    ((0, 0, 1), (-1, 0, 0), (0, -1, 0)): "a vehicle's axes (x forward, y left, z up)",
    ((0, 0, 1), (1, 0, 0), (0, 1, 0)): "a vehicle's axes (x forward, y right, z down)",
}


def _turns() -> Iterator[tuple[str, np.ndarray]]:
    """All rotations that permute axes, as 4×4, with what camera axes they come from; the first is none.

    Row i of the matrix: the axis of the pose's own frame in terms of right, down and forward.
    """
    axes = "xyz"
    for order in permutations(range(3)):
        for signs in product((1, -1), repeat=3):
            R = np.zeros((3, 3))
            R[range(3), order] = signs
            if np.linalg.det(R) < 0:
                continue
            turn = np.eye(4)
            turn[:3, :3] = R
            key = tuple(tuple(int(v) for v in row) for row in R)
            where = [f"{'-' if R[:, j].sum() < 0 else ''}{axes[int(np.flatnonzero(R[:, j])[0])]}" for j in range(3)]
            name = _KNOWN_TURNS.get(
                key, f"camera axes whose {where[0]} is right, {where[1]} down and {where[2]} forward"
            )
            yield ("" if np.array_equal(R, np.eye(3)) else name), turn


def _best_shift(matches: list[Matches], pose_at: PoseAt, camera: PinholeCamera) -> tuple[str, float | None]:
    """The time to add to the frames' at which the poses fit best, as a phrase, and the distance then."""

    def distance(shift: float) -> float:
        if abs(shift) < _LEAST_SHIFT:
            return np.inf
        found = _distance(matches, lambda timestamp: pose_at(timestamp + shift), camera)
        return np.inf if found is None else found

    coarse = min(_SHIFTS.tolist(), key=distance)
    shift = min((coarse + _FINE_SHIFTS).tolist(), key=distance)
    return f"when taken as {abs(shift):.2f} s {'earlier' if shift > 0 else 'later'} than their times say", distance(
        shift
    )
