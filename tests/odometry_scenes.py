"""A textured room with known depth, and what odometry's modules take of it, for several test files."""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np

from polarmap.geometry.camera import PinholeCamera
from polarmap.geometry.lie import se3_exp
from polarmap.geometry.pose import inverse
from polarmap.odometry.options import OdometryOptions
from polarmap.odometry.points import ActivePoints, describe
from polarmap.odometry.pyramid import Pyramid, PyramidFactory
from polarmap.odometry.selection import PointSelector
from polarmap.odometry.window.residuals import GOOD, NONE
from polarmap.odometry.window.window import Window
from polarmap.synth import Box, Material, Pattern, PointLight, Rendering, Scene, Texture, render

CAMERA = PinholeCamera(width=240, height=180, fx=190.0, fy=188.0, cx=119.5, cy=90.0)
OPTIONS = OdometryOptions(points=400, candidates=400)
FACTORY = PyramidFactory(CAMERA)
_GREY = 0.45  # of the scale, the brightest point of the first view


def _paper(size: float, seed: int) -> Material:
    return Material(f"paper {seed}", albedo=0.45, texture=Texture(Pattern.NOISE, size, 0.9, 3, seed), gloss=0.0)


def _at(x: float, y: float, z: float, turn: float = 0.0) -> np.ndarray:
    return se3_exp([x, y, z, 0, 0, 0]) @ se3_exp([0, 0, 0, 0.3 * turn, turn, 0])


ROOM = Scene(
    (
        Box(_paper(0.25, 1), _at(0.0, 0.0, 1.0), size=(4.4, 3.2, 5.0)),
        Box(_paper(0.15, 2), _at(-0.7, 0.5, 2.4, 0.5), size=(0.7, 0.7, 0.7)),
        Box(_paper(0.15, 3), _at(0.9, -0.4, 2.2, -0.4), size=(0.6, 0.8, 0.5)),
    ),
    PointLight(position=(0.3, -0.8, -0.5), intensity=6.0, shadows=False),
    surround=1.0,
)


def motion(*xi: float) -> np.ndarray:
    """T_camera_world from an increment: translation in metres, then rotation in radians."""
    return se3_exp(np.array(xi, float))


@lru_cache
def _rendering(T_camera_world: bytes) -> Rendering:
    return render(ROOM, CAMERA, inverse(np.frombuffer(T_camera_world).reshape(4, 4)), supersample=2)


@lru_cache
def _brightness() -> float:
    return _GREY / float(_rendering(np.eye(4).tobytes()).stokes[0].max())


def image_of(T_camera_world: np.ndarray, noise: float = 0.0, gain: float = 1.0, seed: int = 0) -> np.ndarray:
    """What a camera sees, float32 in [0, 1]; noise: standard deviation in grey values of 255."""
    image = gain * _brightness() * _rendering(np.ascontiguousarray(T_camera_world, float).tobytes()).stokes[0]
    if noise > 0:
        image = image + noise / 255 * np.random.default_rng(seed).standard_normal(image.shape)
    return np.clip(image, 0, 1).astype(np.float32)


def depth_of(T_camera_world: np.ndarray) -> np.ndarray:
    """The room's depth as a camera sees it, float32 H×W."""
    return _rendering(np.ascontiguousarray(T_camera_world, float).tobytes()).depth


def pyramid_of(T_camera_world: np.ndarray, **brightness) -> Pyramid:
    """The pyramid of `image_of`."""
    return FACTORY.make(image_of(T_camera_world, **brightness))


def smooth_pixels(T_camera_world: np.ndarray, count: int, seed: int = 0) -> np.ndarray:
    """Pixels that odometry would choose, int32 N×2, without those at depth edges, where a pattern has no one depth."""
    return _smooth_pixels(np.ascontiguousarray(T_camera_world, float).tobytes(), count, seed)


@lru_cache
def _smooth_pixels(pose: bytes, count: int, seed: int) -> np.ndarray:
    T_camera_world = np.frombuffer(pose).reshape(4, 4)
    depth = depth_of(T_camera_world)
    around = np.ones((7, 7), np.uint8)
    smooth = cv2.dilate(depth, around) < 1.05 * cv2.erode(depth, around)
    return PointSelector(OPTIONS.gradient_threshold, seed, valid=smooth).select(pyramid_of(T_camera_world), count)


def inverse_depth_at(T_camera_world: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    """True inverse depth at whole pixels, float32 N."""
    return (1.0 / depth_of(T_camera_world)[pixels[:, 1], pixels[:, 0]]).astype(np.float32)


def room_window(poses, count: int = 150, gains=None, hosts: int | None = None, noise: float = 0.0) -> Window:
    """A window whose keyframes have the true poses (T_camera_world), and points of true depth in the first `hosts`.

    gains: of the images; the state has exactly this brightness. The first keyframe is held where it is.
    """
    gains = gains or [1.0] * len(poses)
    window = Window(CAMERA, len(poses) + 1)
    for index, (T, gain) in enumerate(zip(poses, gains, strict=True)):
        level = pyramid_of(T, gain=gain, noise=noise, seed=index).levels[0]
        window.add(index, level, T.copy(), np.array([np.log(gain), 0.0]))
    for keyframe in window.keyframes[: hosts or len(poses)]:
        pixels = smooth_pixels(keyframe.T_first, count, seed=keyframe.slot)
        window.points = window.points.joined(_points(window, keyframe.slot, pixels, poses[keyframe.index]))
    return window


def _points(window: Window, slot: int, pixels: np.ndarray, T_camera_world: np.ndarray) -> ActivePoints:
    color, weight, _ = describe(window.images[slot], pixels, OPTIONS.gradient_constant)
    count = len(pixels)
    state = np.full((count, window.capacity), NONE, np.uint8)
    state[:, [k.slot for k in window.keyframes if k.slot != slot]] = GOOD
    return ActivePoints(
        np.full(count, slot, np.int32), pixels.astype(np.float32), inverse_depth_at(T_camera_world, pixels), color,
        weight, state, np.zeros(count, np.float32), np.zeros(count, np.int32),
    )  # fmt: skip
