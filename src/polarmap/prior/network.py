"""Any relative depth network in ONNX form, run on the CPU, behind one call: grey image in, inverse depth out."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from polarmap.errors import InputError
from polarmap.geometry.camera import PinholeCamera
from polarmap.polarization.types import PolarizationImage
from polarmap.prior.encoding import encode_display
from polarmap.prior.network_spec import NetworkSpec, OutputSpace, network_spec
from polarmap.prior.prediction import Prediction

_MAX_INPUT_PIXELS = 4096 * 4096
_MIN_OUTPUT_SIDE = 8
_SMOOTHING = 1.5  # of a network's pixels; takes the noise off slopes and leaves their direction
_INPUT_TYPES = {"tensor(float)": np.float32, "tensor(float16)": np.float16}


@dataclass(frozen=True)
class _ImageInput:
    """A network's input; `size` is height and width, None where the model leaves them open."""

    name: str
    dtype: type
    channels: int
    channels_last: bool
    size: tuple[int | None, int | None]


class DepthNetwork:
    """A relative depth network. `network(intensity)` gives relative inverse depth at the image's resolution."""

    def __init__(self, path: Path | str, spec: NetworkSpec | None = None, threads: int = 2) -> None:
        """Load MODEL.onnx; its specification comes from MODEL.yaml or its name unless given.

        Raises InputError, naming the file, where it is not an ONNX network from one image to one depth map.
        """
        self.path = _existing(Path(path))
        self.spec = spec or network_spec(self.path)
        self._session = open_session(self.path, threads)
        self._input = _image_input(self.path, self._session.get_inputs())
        self._output = self._output_name()
        self._try_out()

    @property
    def name(self) -> str:
        """The file's name without its ending."""
        return self.path.stem

    def __call__(self, intensity: np.ndarray) -> np.ndarray:
        """Relative inverse depth (near is large), float32 H×W, of linear grey intensity, float32 H×W.

        NaN where the network gives none. Raises InputError where the output is not one depth map.
        """
        encoded = encode_display(intensity, self.spec.gamma)
        depth = self._inverse_depth(self._run(self._tensor(encoded)))
        return upsample(depth, intensity.shape)

    def predict(self, image: PolarizationImage, camera: PinholeCamera) -> Prediction:
        """The same of an image's intensity; such a network sees neither polarization nor the camera."""
        return Prediction(self(image.intensity))

    def _output_name(self) -> str:
        names = [node.name for node in self._session.get_outputs()]
        wanted = self.spec.output
        if isinstance(wanted, str) and wanted in names:
            return wanted
        if isinstance(wanted, int) and 0 <= wanted < len(names):
            return names[wanted]
        raise InputError(f"{self.path}: has no output {wanted!r}; its outputs are {', '.join(names)}")

    def _try_out(self) -> None:
        """One run on a ramp, so that an unfit network is found before the sequence starts."""
        ramp = np.tile(np.linspace(1.0, 0.1, 480, dtype=np.float32)[:, None], (1, 640))
        if not np.isfinite(self._run(self._tensor(ramp))).all():
            raise InputError(f"{self.path}: gives NaN or infinite depth; export it again, in float32")

    def _tensor(self, encoded: np.ndarray) -> np.ndarray:
        """The network's input for an encoded grey image."""
        height, width = self._input_size(encoded.shape)
        shrinking = height * width < encoded.size
        image = cv2.resize(encoded, (width, height), interpolation=cv2.INTER_AREA if shrinking else cv2.INTER_CUBIC)
        spec = self.spec
        channels = [spec.full_scale * (image - m) / s for m, s in zip(spec.mean, spec.std, strict=True)]
        stacked = np.stack(channels[: self._input.channels], axis=-1 if self._input.channels_last else 0)
        return np.ascontiguousarray(stacked[None], self._input.dtype)

    def _input_size(self, image: tuple[int, int]) -> tuple[int, int]:
        """Height and width: the model's, else the specified short side and the image's proportions."""
        short, multiple = min(self.spec.input_size or (384, 384)), self.spec.multiple_of
        scale = short / min(image)
        open_size = (max(round(side * scale / multiple), 1) * multiple for side in image)
        return tuple(fixed or free for fixed, free in zip(self._input.size, open_size, strict=True))

    def _run(self, tensor: np.ndarray) -> np.ndarray:
        try:
            output = self._session.run([self._output], {self._input.name: tensor})[0]
        except Exception as error:  # onnxruntime's exceptions have no common base of their own
            raise InputError(f"{self.path}: fails on an input of {tensor.shape} ({_first_line(error)})") from None
        size = tensor.shape[1:3] if self._input.channels_last else tensor.shape[2:]
        return self._depth_map(output, size)

    def _depth_map(self, output: object, input_size: tuple[int, int]) -> np.ndarray:
        """The output as float32 h×w, or InputError where it is no picture of the input's proportions."""
        shape = getattr(output, "shape", ())
        sides = tuple(side for side in shape if side != 1)
        fits = len(sides) == 2 and min(sides) >= _MIN_OUTPUT_SIDE and output.dtype.kind == "f"
        if not fits or abs(sides[0] * input_size[1] / (sides[1] * input_size[0]) - 1.0) > 0.1:
            raise InputError(
                f"{self.path}: output {self._output!r} of shape {list(shape)} is no depth map of an input of "
                f"{input_size[1]}x{input_size[0]}; name the right one as 'output' in {self.path.with_suffix('.yaml')}"
            )
        return output.reshape(sides).astype(np.float32)

    def _inverse_depth(self, depth: np.ndarray) -> np.ndarray:
        if self.spec.output_space is OutputSpace.DEPTH:
            with np.errstate(divide="ignore", invalid="ignore"):
                return np.where(depth > 0, 1.0 / depth, np.nan).astype(np.float32)
        if self.spec.output_space is OutputSpace.LOG_DEPTH:
            return np.exp(np.clip(-depth, -80.0, 80.0))
        return depth


def _existing(path: Path) -> Path:
    if not os.path.isfile(path):
        raise InputError(f"{path}: there is no such file; give the path of an ONNX network, 'polarnet' or 'sparse'")
    return path


def open_session(path: Path, threads: int):
    """The ONNX Runtime session of a file, on the CPU; InputError where it is no ONNX network."""
    import onnxruntime  # slow to import, and needed by those alone who bring a network

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads
    options.inter_op_num_threads = 1
    options.log_severity_level = 4  # what it would log comes as an exception
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")  # other steps want the cores
    try:
        return onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
    except Exception as error:  # onnxruntime's exceptions have no common base of their own
        raise InputError(f"{path}: is not an ONNX network that can be run ({_first_line(error)})") from None


def _image_input(path: Path, inputs: list) -> _ImageInput:
    if len(inputs) != 1:
        raise InputError(f"{path}: takes {len(inputs)} inputs; a depth network of one image is needed")
    (node,) = inputs
    if node.type not in _INPUT_TYPES:
        raise InputError(f"{path}: its input is a {node.type}; a float32 or float16 tensor is needed")
    shape = [side if isinstance(side, int) and side > 0 else None for side in node.shape]
    if len(shape) != 4 or shape[0] not in (1, None):
        raise InputError(f"{path}: its input shape {node.shape} is not that of one image, such as [1, 3, H, W]")
    channels_last = shape[3] in (1, 3) and shape[1] not in (1, 3)
    channels, height, width = (shape[3], *shape[1:3]) if channels_last else shape[1:]
    if channels not in (1, 3, None):
        raise InputError(f"{path}: its input {node.shape} has {channels} channels; 1 or 3 are needed")
    if (height or 1) * (width or 1) > _MAX_INPUT_PIXELS:
        raise InputError(f"{path}: its input of {width}x{height} pixels is too large")
    return _ImageInput(node.name, _INPUT_TYPES[node.type], channels or 3, channels_last, (height, width))


def _first_line(error: Exception) -> str:
    return (str(error).strip().splitlines() or [type(error).__name__])[0][:200]


def upsample(depth: np.ndarray, shape: tuple[int, int], smoothing: float = _SMOOTHING) -> np.ndarray:
    """Bicubic, then smoothed, since stairs and noise would turn the slopes taken from it; float32 H×W.

    smoothing: standard deviation in pixels of `depth`.
    """
    resized = cv2.resize(depth, shape[::-1], interpolation=cv2.INTER_CUBIC)
    sigma = smoothing * max(shape[0] / depth.shape[0], 1.0)
    return cv2.GaussianBlur(resized, (0, 0), sigma)
