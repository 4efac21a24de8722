"""Whether poses fit the pictures: right and noisy ones pass in silence, and usual mistakes are named."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from polarmap.data.frame import Frame
from polarmap.data.trajectory import Trajectory
from polarmap.geometry.camera import PinholeCamera
from polarmap.geometry.pose import inverse
from polarmap.pipeline.poses.fit import Matches, fit_of_poses, judge

CAMERA = PinholeCamera(320, 240, 240.0, 240.0, 159.5, 119.5)
TIMES = np.arange(60) / 30.0


def hand_held(t: float) -> np.ndarray:
    """T_world_camera of a camera that walks along a wall, turning a little, 20 degrees off the world's axes."""
    T = np.eye(4)
    angles = [20 + 4 * np.sin(5.1 * t), 10 + 9 * np.sin(3.3 * t), 3 * np.cos(4.7 * t)]
    T[:3, :3] = Rotation.from_euler("xyz", angles, degrees=True).as_matrix()
    T[:3, 3] = 5.0 + 0.5 * t, 1.0 + 0.15 * np.sin(2.5 * t), -2.0 + 0.2 * np.cos(1.9 * t)
    return T


def matches(noise: float = 0.05) -> list[Matches]:
    """Points in space as frames four apart see them."""
    rng = np.random.default_rng(5)
    found = []
    for start in range(0, 50, 7):
        first, second = hand_held(TIMES[start]), hand_held(TIMES[start + 4])
        points = rng.uniform((-1.5, -1.0, 2.0), (1.5, 1.0, 5.0), (100, 3))
        moved = points @ (inverse(second) @ first)[:3, :3].T + (inverse(second) @ first)[:3, 3]
        pixels = [(p @ CAMERA.matrix.T)[:, :2] / p[:, 2:] + rng.normal(0, noise, (100, 2)) for p in (points, moved)]
        found.append(Matches(*pixels, (float(TIMES[start]), float(TIMES[start + 4]))))
    return found


def given(change=lambda T: T, late: float = 0.0):
    """The true poses after a mistake."""
    return Trajectory(TIMES + late, np.array([change(hand_held(t)) for t in TIMES])).at


def turned(*rows) -> np.ndarray:
    T = np.eye(4)
    T[:3, :3] = np.array(rows, float)
    return T


OPENGL = turned((1, 0, 0), (0, -1, 0), (0, 0, -1))
VEHICLE = turned((0, -1, 0), (0, 0, -1), (1, 0, 0))  # its x is the camera's forward


def w_first(T):
    x, y, z, w = Rotation.from_matrix(T[:3, :3]).as_quat()
    changed = T.copy()
    changed[:3, :3] = Rotation.from_quat([w, x, y, z]).as_matrix()
    return changed


def rotation_inverted(T):
    changed = T.copy()
    changed[:3, :3] = T[:3, :3].T
    return changed


@pytest.mark.parametrize("scale", [1.0, 1000.0])
@pytest.mark.parametrize("noise", [0.02, 0.3])
def test_right_poses_fit_in_any_unit(noise, scale):
    def scaled(T):
        return np.block([[T[:3, :3], scale * T[:3, 3:]], [T[3:]]])

    fit = judge(matches(noise), given(scaled), CAMERA)
    assert fit.fits and fit.distance < 0.5 and not fit.reading


def test_right_poses_with_noise_of_their_own_are_not_suspected():
    rng = np.random.default_rng(1)

    def noisy(T):
        error = np.eye(4)
        error[:3, :3] = Rotation.from_rotvec(rng.normal(0, 0.001, 3)).as_matrix()
        error[:3, 3] = rng.normal(0, 0.002, 3)
        return T @ error

    assert judge(matches(), given(noisy), CAMERA).reading == ""


@pytest.mark.parametrize(
    ("mistake", "words"),
    [
        (inverse, "as world-to-camera poses"),
        (lambda T: T @ OPENGL, "OpenGL"),
        (lambda T: inverse(T @ OPENGL), "world-to-camera poses with OpenGL"),
        (lambda T: T @ VEHICLE, "vehicle's axes (x forward, y left"),
        (w_first, "quaternion begins with w"),
        (rotation_inverted, "rotation is world-to-camera"),
    ],
)
def test_a_convention_is_named(mistake, words):
    fit = judge(matches(), given(mistake), CAMERA)
    assert not fit.fits and words in fit.reading and fit.corrected < 0.2


@pytest.mark.parametrize(
    ("late", "words"), [(0.18, "0.18 s earlier"), (-0.09, "0.09 s later"), (0.4, "0.40 s earlier")]
)
def test_another_clock_is_named(late, words):
    fit = judge(matches(), given(late=late), CAMERA)
    assert not fit.fits and words in fit.reading


def test_a_focal_length_of_the_whole_mosaic_is_named():
    camera = PinholeCamera(320, 240, 480.0, 480.0, 159.5, 119.5)
    fit = judge(matches(), given(), camera)
    assert not fit.fits and "0.5 times the focal length" in fit.reading


def test_poses_of_another_recording_fit_in_no_way():
    rng = np.random.default_rng(3)
    steps = [Rotation.from_rotvec(v) for v in np.cumsum(rng.normal(0, 0.1, (60, 3)), axis=0)]
    poses = np.tile(np.eye(4), (60, 1, 1))
    poses[:, :3, :3] = [R.as_matrix() for R in steps]
    poses[:, :3, 3] = np.cumsum(rng.normal(0, 0.1, (60, 3)), axis=0)
    fit = judge(matches(), Trajectory(TIMES, poses).at, CAMERA)
    assert not fit.fits and not fit.reading


def test_a_camera_that_stands_still_tells_nothing():
    assert judge(matches(), lambda t: np.eye(4), CAMERA) is None
    assert judge([], given(), CAMERA) is None


def test_pictures_are_followed(tmp_path):
    """A wall seen by a camera that moves: the matches are found in the pictures."""
    rng = np.random.default_rng(0)
    wall = cv2.GaussianBlur(rng.random((900, 1200), np.float32), (0, 0), 3)
    wall = np.clip(0.5 + 6 * (wall - wall.mean()), 0.02, 1)
    per_metre = 200.0
    wall_pixels = np.array([[per_metre, 0, 600], [0, per_metre, 450], [0, 0, 1.0]])  # metres on the wall to its pixels

    def pose(t):
        T = hand_held(t)
        T[:3, :3] = Rotation.from_euler("y", 6 * np.sin(1.3 * t), degrees=True).as_matrix()
        T[:3, 3] = 0.4 * t - 0.4, 0.1 * np.sin(2.5 * t), -2.0
        return T

    def picture(position):
        T = inverse(pose(TIMES[position]))
        H = CAMERA.matrix @ np.column_stack([T[:3, 0], T[:3, 1], T[:3, 3]]) @ np.linalg.inv(wall_pixels)
        return cv2.warpPerspective(wall, H, (320, 240))

    def frame(position):
        return Frame(position, float(TIMES[position]), "", tmp_path)

    def fit(poses):
        at = Trajectory(TIMES, poses).at
        return fit_of_poses(frame, lambda f: picture(f.index), TIMES, at, CAMERA)

    true = np.array([pose(t) for t in TIMES])
    assert fit(true).fits and fit(true).distance < 0.2
    assert not fit(np.array([inverse(T) for T in true])).fits
