"""The package's own depth network, which sees polarization: relative depth, normals, kinds of reflection, variances.

Trained on rendered scenes alone (docs/prior_network.md). It also takes grey images, without polarization, but then
knows less.
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from polarmap.errors import InputError
from polarmap.geometry.camera import PinholeCamera
from polarmap.polarization.types import PolarizationImage
from polarmap.prior.network import open_session, upsample
from polarmap.prior.polarization_input import CHANNELS, network_input
from polarmap.prior.prediction import Prediction
from polarmap.prior_names import POLARNET

WEIGHTS = Path(__file__).with_name("polarnet.onnx")
OUTPUTS = ("inverse_depth", "normal", "specular", "log_variance_depth", "log_variance_normal")

PIXELS = "input_pixels"
"""Key of the file's metadata: the number of pixels of the pictures that it was trained on."""

_MULTIPLE = 32
_SMOOTHING = 0.6  # of an output's pixels, which are wide and have little noise
_MOST_PIXELS = 4096 * 4096


class PolarNetwork:
    """The network of a file made by `training.export`, by default the one in the package.

    Raises InputError, naming the file, where it is missing or is no such network.
    """

    name = POLARNET

    def __init__(self, path: Path | str = WEIGHTS, threads: int = 2) -> None:
        self.path = Path(path)
        if not self.path.is_file():
            raise InputError(f"{self.path}: there is no such file; install polarmap again, or use the prior 'sparse'")
        self._session = open_session(self.path, threads)
        inputs = self._session.get_inputs()
        outputs = tuple(node.name for node in self._session.get_outputs())
        if len(inputs) != 1 or len(inputs[0].shape) != 4 or inputs[0].shape[1] != CHANNELS or outputs != OUTPUTS:
            raise InputError(f"{self.path}: is not a network of this package; export one with training/export.py")
        self._input = inputs[0].name
        self._pixels = self._trained_pixels()

    def predict(self, image: PolarizationImage, camera: PinholeCamera) -> Prediction:
        """All outputs at the image's resolution."""
        depth, normal, specular, variance_depth, variance_normal = self._run(image, camera)
        shape = image.intensity.shape
        normal = np.stack([_enlarged(n, shape) for n in normal], axis=-1)
        return Prediction(
            upsample(depth[0], shape, _SMOOTHING),
            normal / np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-6),
            _enlarged(1.0 / (1.0 + np.exp(-specular[0])), shape),
            _enlarged(np.exp(0.5 * variance_depth[0]), shape),
            _enlarged(np.exp(0.5 * variance_normal[0]), shape),
        )

    def _run(self, image: PolarizationImage, camera: PinholeCamera) -> list[np.ndarray]:
        """Outputs of the network at its own resolution, C×h×w each."""
        if image.intensity.shape != camera.shape:
            raise InputError(f"prior: intensity {image.intensity.shape} does not fit the camera {camera.shape}")
        tensor = _input(image, camera, _input_size(camera.shape, self._pixels))
        both = np.stack([tensor, _mirrored_input(tensor)])
        found = self._session.run(list(OUTPUTS), {self._input: both})
        return [_mean_of_both(name, *pair) for name, pair in zip(OUTPUTS, found, strict=True)]

    def _trained_pixels(self) -> int:
        text = self._session.get_modelmeta().custom_metadata_map.get(PIXELS, "")
        if not (text.isascii() and text.isdigit() and 0 < int(text[:12]) <= _MOST_PIXELS):
            raise InputError(f"{self.path}: does not say the size of its input; export it with training/export.py")
        return int(text)


def _input_size(shape: tuple[int, int], pixels: int) -> tuple[int, int]:
    """Height and width of the image's proportions, about as many pixels as in training."""
    scale = np.sqrt(pixels / (shape[0] * shape[1]))
    return tuple(max(round(side * scale / _MULTIPLE), 1) * _MULTIPLE for side in shape)


def _input(image: PolarizationImage, camera: PinholeCamera, size: tuple[int, int]) -> np.ndarray:
    """Stokes components averaged down, clipped and dark pixels unpolarized; and the rays of that grid."""
    polarized = np.where(image.usable, image.dolp, 0.0).astype(np.float32) * (2.0 * image.intensity)
    stokes = (image.intensity, polarized * np.cos(2.0 * image.aolp), polarized * np.sin(2.0 * image.aolp))
    intensity, s1, s2 = (_reduced(channel, size) for channel in stokes)
    return network_input(intensity, s1, s2, camera.resized(size).normalized())


def _mirrored_input(tensor: np.ndarray) -> np.ndarray:
    """The input of the mirrored scene: left and right change places, S2 and x their signs."""
    mirrored = tensor[..., ::-1].copy()
    mirrored[3:5] *= -1.0
    return mirrored


def _mean_of_both(name: str, output: np.ndarray, of_mirrored: np.ndarray) -> np.ndarray:
    """The mean of an output, C×h×w, and of what the mirrored scene gave, mirrored back: their errors differ."""
    back = of_mirrored[..., ::-1]
    if name == "normal":
        back = back * np.array([-1.0, 1.0, 1.0], np.float32)[:, None, None]
    return 0.5 * (output + back)


def _reduced(channel: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    clean = np.nan_to_num(channel, nan=0.0).astype(np.float32)
    return cv2.resize(clean, size[::-1], interpolation=cv2.INTER_AREA)


def _enlarged(channel: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    return cv2.resize(channel.astype(np.float32), shape[::-1], interpolation=cv2.INTER_LINEAR)
