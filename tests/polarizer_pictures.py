"""Raw pictures of a sensor whose polarizers are not ideal, by the law of Malus, with its noise."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from polarmap.data.camera_file import CameraFile
from polarmap.data.frame import Frame
from polarmap.data.polarizers import PolarizerCalibration
from polarmap.data.sensor import AngleDirection

TRUTH = PolarizerCalibration((1.8, 43.1, 92.2, 132.9), (1.03, 0.98, 1.01, 0.98), (0.985, 0.962, 0.974, 0.95))
"""Angles off by up to 2.2°, whose mean is right, gains by 3 %."""


def mosaic_of(
    camera_file: CameraFile,
    truth: PolarizerCalibration,
    stokes: np.ndarray,
    rng: np.random.Generator,
    black: float | None = None,
    shade: float = 0.0,
) -> np.ndarray:
    """The raw mosaic of one Stokes vector, float64 3, or of an image of them, 3×H×W, clockwise as displayed.

    black: true black level, the camera file's where None. shade: by how much the corners are darker than the middle.
    """
    height, width = camera_file.camera.shape
    image = stokes if stokes.ndim == 3 else stokes[:, None, None]
    channels = np.tensordot(truth.measurement_matrix(camera_file.angle_direction), image, axes=1)
    y, x = np.mgrid[-1 : 1 : height * 1j, -1 : 1 : width * 1j]
    channels = channels * np.ones((height, width)) * (1 - shade * (x**2 + y**2) / 2)
    noise, white = camera_file.noise, camera_file.white_level
    electrons = rng.poisson(np.maximum(channels, 0) * noise.full_well) + rng.normal(0, noise.read_noise, channels.shape)
    black = camera_file.black_level if black is None else black
    values = np.clip(np.round(electrons / noise.full_well * (white - black) + black), 0, white)
    raw = np.zeros((2 * height, 2 * width), np.uint8 if camera_file.bit_depth == 8 else np.uint16)
    order = [0, 1, 2, 3] if camera_file.angle_direction is AngleDirection.CLOCKWISE else [0, 3, 2, 1]
    for label, channel in zip((0, 45, 90, 135), values[order], strict=True):
        row, column = divmod(camera_file.layout.value.index(label), 2)
        raw[row::2, column::2] = channel
    return raw


def frame(raw: np.ndarray, name: str = "picture") -> Frame:
    return Frame(0, float("nan"), name, Path(f"{name}.png"), mosaic=raw)


def behind_polarizer(camera_file: CameraFile, degrees: float, light: float = 0.8) -> np.ndarray:
    """The Stokes vector of light polarized along an angle that turns as the labels do."""
    sign = 1 if camera_file.angle_direction is AngleDirection.CLOCKWISE else -1
    double = np.radians(2 * sign * degrees)
    return light * np.array([1.0, np.cos(double), np.sin(double)])
