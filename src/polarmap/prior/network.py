"""Any relative depth network in ONNX form, run on the CPU, behind one call: grey image in, inverse depth out."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from polarmap.data.polarization_image import PolarizationImage
from polarmap.errors import InputError
from polarmap.geometry.camera import PinholeCamera
from polarmap.prior.encoding import encode_display
from polarmap.prior.network_input import image_input
from polarmap.prior.network_spec import NetworkSpec, OutputSpace, is_declared, network_spec
from polarmap.prior.options import PriorOptions
from polarmap.prior.prediction import Prediction
from polarmap.prior.session import Session

_MIN_OUTPUT_SIDE = 8
_PROPORTIONS = 0.1  # by which those of an output may differ from the picture's
_SMOOTHING = 1.5  # of a network's pixels; takes the noise off slopes and leaves their direction


class DepthNetwork:
    """A relative depth network. `network(intensity)` gives relative inverse depth at the image's resolution.

    declared: whether its output space was said in a sidecar or `spec`, and not only known by the file's name.
    """

    def __init__(
        self,
        path: Path | str,
        spec: NetworkSpec | None = None,
        threads: int = 2,
        time_limit: float = PriorOptions().time_limit,
    ) -> None:
        """Load MODEL.onnx; its specification comes from MODEL.yaml or its name unless given.

        time_limit: seconds that it may take for a picture. Raises InputError, naming the file, where it is not an ONNX
        network from one image to one depth map, or does not give one in time.
        """
        self.path = _existing(Path(path))
        self.declared = spec is not None or is_declared(self.path)
        self.spec = spec or network_spec(self.path)
        self._session = Session(self.path, threads, time_limit)
        self._input = image_input(self.path, self._session.inputs)
        self._output = self._output_name()
        self._try_out()

    @property
    def name(self) -> str:
        """The file's name without its ending."""
        return self.path.stem

    def __call__(self, intensity: np.ndarray) -> np.ndarray:
        """Relative inverse depth (near is large), float32 H×W, of linear grey intensity, float32 H×W.

        NaN where the network gives none: no finite value, or no positive depth, as some say of the sky. Raises
        InputError where the output is not one depth map, or does not come in time.
        """
        depth = self._inverse_depth(self._run(encode_display(intensity, self.spec.gamma)))
        invalid = ~np.isfinite(depth)
        if invalid.all():
            return np.full(intensity.shape, np.nan, np.float32)
        found = upsample(_filled(depth, invalid), intensity.shape)
        if invalid.any():
            found[_enlarged_mask(invalid, intensity.shape)] = np.nan
        return found

    def predict(self, image: PolarizationImage, camera: PinholeCamera, hurry: bool = False) -> Prediction:
        """The same of an image's intensity: such a network sees neither polarization nor the camera; none hurries."""
        return Prediction(self(image.intensity))

    def _output_name(self) -> str:
        names = self._session.output_names
        wanted = self.spec.output
        if isinstance(wanted, str) and wanted in names:
            return wanted
        if isinstance(wanted, int) and 0 <= wanted < len(names):
            return names[wanted]
        raise InputError(f"{self.path}: has no output {wanted!r}; its outputs are {', '.join(names)[:200]}")

    def _try_out(self) -> None:
        """One run on a ramp, so that an unfit network is found before the sequence starts."""
        ramp = np.tile(np.linspace(1.0, 0.1, 480, dtype=np.float32)[:, None], (1, 640))
        if not np.isfinite(self._inverse_depth(self._run(ramp))).any():
            raise InputError(
                f"{self.path}: gives NaN, infinite or no positive depth at every pixel of a test picture; check how it "
                f"was exported, and output and output_space in {self.path.with_suffix('.yaml')}"
            )

    def _run(self, encoded: np.ndarray) -> np.ndarray:
        """The network's output for an encoded picture, float32 h×w."""
        tensor = self._input.tensor(encoded, self.spec)
        output = self._session.run([self._output], {self._input.name: tensor})[0]
        return self._depth_map(output, self._input.image_size(tensor), encoded.shape)

    def _depth_map(self, output: Any, fed: tuple[int, int], picture: tuple[int, int]) -> np.ndarray:
        """The output as float32 h×w; InputError where it has the proportions of neither its input nor the picture."""
        shape = getattr(output, "shape", ())
        sides = tuple(side for side in shape if side != 1)
        fits = len(sides) == 2 and min(sides) >= _MIN_OUTPUT_SIDE and output.dtype.kind == "f"
        if not fits or all(_stretch(sides, size) > _PROPORTIONS for size in (fed, picture)):
            raise InputError(
                f"{self.path}: output {self._output!r} of shape {list(shape)} is no depth map of an input of "
                f"{fed[1]}x{fed[0]}; name the right one as 'output' in {self.path.with_suffix('.yaml')}"
            )
        return output.reshape(sides).astype(np.float32)

    def _inverse_depth(self, depth: np.ndarray) -> np.ndarray:
        """Not finite where the output says nothing, float32 h×w."""
        if self.spec.output_space is OutputSpace.DEPTH:
            valid = np.isfinite(depth) & (depth > 0)
            with np.errstate(divide="ignore", over="ignore"):
                return np.where(valid, 1.0 / np.where(valid, depth, 1.0), np.nan).astype(np.float32)
        if self.spec.output_space is OutputSpace.LOG_DEPTH:
            return np.where(np.isfinite(depth), np.exp(np.clip(-depth, -80.0, 80.0)), np.nan).astype(np.float32)
        return depth


def _existing(path: Path) -> Path:
    if not os.path.isfile(path):
        raise InputError(f"{path}: there is no such file; give the path of an ONNX network, 'polarnet' or 'sparse'")
    return path


def _stretch(sides: tuple[int, int], size: tuple[int, int]) -> float:
    """By what share the proportions of two sizes differ."""
    return abs(sides[0] * size[1] / (sides[1] * size[0]) - 1.0)


def _filled(depth: np.ndarray, invalid: np.ndarray) -> np.ndarray:
    """The nearest valid value where there is none, so that resizing and smoothing spread no NaN."""
    if not invalid.any():
        return depth
    source = invalid.astype(np.uint8)
    _, label = cv2.distanceTransformWithLabels(source, cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL)
    of_label = np.zeros(label.max() + 1, np.float32)
    of_label[label[~invalid]] = depth[~invalid]
    return of_label[label]


def _enlarged_mask(mask: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    return cv2.resize(mask.astype(np.uint8), shape[::-1], interpolation=cv2.INTER_NEAREST).astype(bool)


def upsample(depth: np.ndarray, shape: tuple[int, int], smoothing: float = _SMOOTHING) -> np.ndarray:
    """Bicubic, then smoothed, since stairs and noise would turn the slopes taken from it; float32 H×W.

    smoothing: standard deviation in pixels of `depth`.
    """
    resized = cv2.resize(depth, shape[::-1], interpolation=cv2.INTER_CUBIC)
    sigma = smoothing * max(shape[0] / depth.shape[0], 1.0)
    return cv2.GaussianBlur(resized, (0, 0), sigma)
