"""How a network wants its one image: type, channels, sizes; and an encoded picture in that form."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from polarmap.errors import InputError
from polarmap.prior.network_spec import NetworkSpec

_MAX_PIXELS = 4096 * 4096
_USUAL_SIZE = (384, 384)
_TYPES = {
    "tensor(float)": np.float32,
    "tensor(float16)": np.float16,
    "tensor(double)": np.float64,
    "tensor(uint8)": np.uint8,
}


@dataclass(frozen=True)
class ImageInput:
    """A network's input. leading: its dimensions of one before the image, such as batch and view.

    size: height and width, None where the model leaves them open.
    """

    name: str
    dtype: type
    channels: int
    channels_last: bool
    leading: int
    size: tuple[int | None, int | None]

    def tensor(self, encoded: np.ndarray, spec: NetworkSpec) -> np.ndarray:
        """The input for a grey picture encoded in [0, 1], float32 H×W."""
        height, width = self._size_for(encoded.shape, spec)
        shrinking = height * width < encoded.size
        image = cv2.resize(encoded, (width, height), interpolation=cv2.INTER_AREA if shrinking else cv2.INTER_CUBIC)
        if self.dtype is np.uint8:  # such a network does its own normalization
            channels = [np.clip(np.rint(255.0 * image), 0, 255)] * self.channels
        else:
            channels = [spec.full_scale * (image - m) / s for m, s in zip(spec.mean, spec.std, strict=True)]
        stacked = np.stack(channels[: self.channels], axis=-1 if self.channels_last else 0)
        return np.ascontiguousarray(stacked[(None,) * self.leading], self.dtype)

    def image_size(self, tensor: np.ndarray) -> tuple[int, int]:
        """Height and width of an input."""
        return tensor.shape[-3:-1] if self.channels_last else tensor.shape[-2:]

    def _size_for(self, image: tuple[int, int], spec: NetworkSpec) -> tuple[int, int]:
        """Height and width: the model's, else the specified short side and the image's proportions."""
        short, multiple = min(spec.input_size or _USUAL_SIZE), spec.multiple_of
        scale = short / min(image)
        open_size = (max(round(side * scale / multiple), 1) * multiple for side in image)
        return tuple(fixed or free for fixed, free in zip(self.size, open_size, strict=True))


def image_input(path: Path, inputs: list) -> ImageInput:
    """The only input of a network; InputError, naming the file, where it is not that of one image."""
    if len(inputs) != 1:
        names = ", ".join(node.name for node in inputs)[:100]
        raise InputError(f"{path}: takes {len(inputs)} inputs ({names}); a depth network of one image is needed")
    (node,) = inputs
    if node.type not in _TYPES:
        raise InputError(f"{path}: its input is a {node.type}; a float32, float16 or uint8 tensor is needed")
    shape = [side if isinstance(side, int) and side > 0 else None for side in node.shape]
    if len(shape) not in (4, 5):
        raise InputError(f"{path}: its input shape {node.shape} is not that of one image, such as [1, 3, H, W]")
    many = next((side for side in shape[:-3] if side not in (1, None)), None)
    if many:
        raise InputError(
            f"{path}: its input {node.shape} is not that of one image but takes {many} at once; "
            "export it for one, or with that size open"
        )
    channels_last = shape[-1] in (1, 3) and shape[-3] not in (1, 3)
    channels, height, width = (shape[-1], *shape[-3:-1]) if channels_last else shape[-3:]
    if channels not in (1, 3, None):
        raise InputError(f"{path}: its input {node.shape} has {channels} channels; 1 or 3 are needed")
    if (height or 1) * (width or 1) > _MAX_PIXELS:
        raise InputError(f"{path}: its input of {width}x{height} pixels is too large")
    return ImageInput(node.name, _TYPES[node.type], channels or 3, channels_last, len(shape) - 3, (height, width))
