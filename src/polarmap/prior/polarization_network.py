"""The package's own depth network, which sees polarization: relative depth, normals, kinds of reflection, variances.

Trained on rendered scenes alone (docs/prior_network.md). It also takes grey images, without polarization, but then
knows less.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from numba import prange

from polarmap.data.polarization_image import PolarizationImage
from polarmap.errors import InputError
from polarmap.geometry.camera import PinholeCamera
from polarmap.jit import njit
from polarmap.prior.names import POLARNET
from polarmap.prior.network import upsample
from polarmap.prior.options import PriorOptions
from polarmap.prior.polarization_input import CHANNELS, network_input
from polarmap.prior.prediction import Prediction
from polarmap.prior.session import Session

WEIGHTS = Path(__file__).with_name("polarnet.onnx")
OUTPUTS = ("inverse_depth", "normal", "specular", "log_variance_depth", "log_variance_normal")

PIXELS = "input_pixels"
"""Key of the file's metadata: the number of pixels of the pictures that it was trained on."""

_MULTIPLE = 32
_LOOKS = {
    1: ((1.0, False),),
    2: ((2 / 3, False), (1.0, True)),
    3: ((2 / 3, False), (1.0, True), (1.4, False)),
}
"""By how many there are: shares of those pixels that it is shown a picture with, and whether mirrored: so its errors
differ, and their mean is smaller than any."""
_FINER = 1.7  # times as many pixels as its largest input must be left to take exact means from
_SMOOTHING = 0.6  # of an output's pixels, which are wide and have little noise
_MOST_PIXELS = 4096 * 4096


class PolarNetwork:
    """The network of a file made by `training.export`, by default the one in the package.

    looks: at a picture, from 1 to 3.
    Raises InputError, naming the file, where it is missing or is no such network.
    """

    name = POLARNET

    def __init__(
        self,
        path: Path | str = WEIGHTS,
        threads: int = 2,
        time_limit: float = PriorOptions().time_limit,
        looks: int = PriorOptions().looks,
    ) -> None:
        self.path = Path(path)
        self.looks = looks
        if not os.path.isfile(self.path):
            raise InputError(f"{self.path}: there is no such file; install polarmap again, or use the prior 'sparse'")
        self._session = Session(self.path, threads, time_limit)
        inputs = self._session.inputs
        outputs = tuple(self._session.output_names)
        if len(inputs) != 1 or len(inputs[0].shape) != 4 or inputs[0].shape[1] != CHANNELS or outputs != OUTPUTS:
            raise InputError(f"{self.path}: is not a network of this package; export one with training/export.py")
        self._input = inputs[0].name
        self._pixels = self._trained_pixels()

    def predict(self, image: PolarizationImage, camera: PinholeCamera, hurry: bool = False) -> Prediction:
        """All outputs at the image's resolution. hurry: by one look, however many there are else."""
        looks = _LOOKS[1 if hurry else self.looks]
        depth, normal, specular, variance_depth, variance_normal = self._run(image, camera, looks)
        shape = image.intensity.shape
        return Prediction(
            upsample(depth[0], shape, _SMOOTHING),
            _unit(_enlarged(np.ascontiguousarray(normal.transpose(1, 2, 0)), shape)),
            _enlarged(1.0 / (1.0 + np.exp(-specular[0])), shape),
            _enlarged(np.exp(0.5 * variance_depth[0]), shape),
            _enlarged(np.exp(0.5 * variance_normal[0]), shape),
        )

    def _run(
        self, image: PolarizationImage, camera: PinholeCamera, shown: Sequence[tuple[float, bool]]
    ) -> list[np.ndarray]:
        """Outputs of the network at its own resolution, C×h×w each: the mean of what it says of several looks."""
        if image.intensity.shape != camera.shape:
            raise InputError(f"prior: intensity {image.intensity.shape} does not fit the camera {camera.shape}")
        largest = max(share for share, _ in shown)
        stokes = [_halved(channel, _FINER * largest * self._pixels) for channel in _stokes(image)]
        sizes = [_input_size(camera.shape, share * self._pixels) for share, _ in shown]
        looks = [
            self._look(_input(stokes, camera, size), mirrored) for size, (_, mirrored) in zip(sizes, shown, strict=True)
        ]
        finest = tuple(side // 2 for side in max(sizes, key=np.prod))
        return [
            np.mean([_resized(output, finest) for output in outputs], axis=0) for outputs in zip(*looks, strict=True)
        ]

    def _look(self, tensor: np.ndarray, mirrored: bool) -> list[np.ndarray]:
        """All outputs for one input; where asked to by way of the mirrored scene, and mirrored back."""
        if mirrored:
            tensor = _mirrored_input(tensor)
        found = [output[0] for output in self._session.run(OUTPUTS, {self._input: tensor[None]})]
        return (
            [_mirrored_back(name, output) for name, output in zip(OUTPUTS, found, strict=True)] if mirrored else found
        )

    def _trained_pixels(self) -> int:
        text = self._session.metadata.get(PIXELS, "")
        if not (text.isascii() and text.isdigit() and 0 < int(text[:12]) <= _MOST_PIXELS):
            raise InputError(f"{self.path}: does not say the size of its input; export it with training/export.py")
        return int(text)


def _input_size(shape: tuple[int, int], pixels: float) -> tuple[int, int]:
    """Height and width of the image's proportions with about so many pixels."""
    scale = np.sqrt(pixels / (shape[0] * shape[1]))
    return tuple(max(round(side * scale / _MULTIPLE), 1) * _MULTIPLE for side in shape)


def _stokes(image: PolarizationImage) -> tuple[np.ndarray, ...]:
    """S0/2, S1, S2, clipped and dark pixels unpolarized."""
    s0 = np.where(image.usable, np.float32(2.0) * image.intensity, np.float32(0.0))
    s1, s2 = image.components
    return image.intensity, s0 * s1, s0 * s2


def _input(stokes: Sequence[np.ndarray], camera: PinholeCamera, size: tuple[int, int]) -> np.ndarray:
    """Stokes components averaged down, and the rays of that grid."""
    intensity, s1, s2 = (_reduced(channel, size) for channel in stokes)
    return network_input(intensity, s1, s2, camera.resized(size).normalized())


def _mirrored_input(tensor: np.ndarray) -> np.ndarray:
    """The input of the mirrored scene: left and right change places, S2 and x their signs."""
    mirrored = tensor[..., ::-1].copy()
    mirrored[3:5] *= -1.0
    return mirrored


def _mirrored_back(name: str, output: np.ndarray) -> np.ndarray:
    """An output for the mirrored scene, C×h×w, as that for the scene itself."""
    back = output[..., ::-1]
    return back * np.array([-1.0, 1.0, 1.0], np.float32)[:, None, None] if name == "normal" else back


def _halved(channel: np.ndarray, least: float) -> np.ndarray:
    """NaN for 0, and halved as long as so many pixels remain: quickly, before the slow means over parts of pixels."""
    clean = cv2.patchNaNs(channel.astype(np.float32), 0.0)
    while clean.size >= 4 * least and not (clean.shape[0] % 2 or clean.shape[1] % 2):
        clean = cv2.resize(clean, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
    return clean


def _reduced(channel: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    return cv2.resize(channel, size[::-1], interpolation=cv2.INTER_AREA)


def _resized(output: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    return np.stack([_enlarged(np.ascontiguousarray(channel), shape) for channel in output])


def _unit(normal: np.ndarray) -> np.ndarray:
    """In place, float32 H×W×3."""
    _normalize(normal)
    return normal


@njit(parallel=True, error_model="numpy")
def _normalize(normal):
    for v in prange(normal.shape[0]):
        for u in range(normal.shape[1]):
            x, y, z = normal[v, u, 0], normal[v, u, 1], normal[v, u, 2]
            scale = np.float32(1.0) / max(np.sqrt(x * x + y * y + z * z), np.float32(1e-6))
            normal[v, u, 0], normal[v, u, 1], normal[v, u, 2] = scale * x, scale * y, scale * z


def _enlarged(channel: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    return cv2.resize(channel.astype(np.float32), shape[::-1], interpolation=cv2.INTER_LINEAR)
