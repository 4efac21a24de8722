"""Arrays to colour pictures: RGB uint8 H×W×3, missing values dark grey. No files, no figures."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import hsv_to_rgb

MISSING = (40, 40, 40)
SATURATED = (255, 0, 255)
UNDEREXPOSED = (0, 110, 255)
# By code: none, diffuse, specular, metal; none, stereo, propagated, estimated.
LABEL_COLOURS = (MISSING, (66, 135, 245), (250, 150, 40), (225, 225, 235))
ORIGIN_COLOURS = (MISSING, (235, 85, 70), (80, 170, 90), (85, 125, 225))


def grey(intensity: np.ndarray, white: float = 1.0) -> np.ndarray:
    """A linear image as a display shows it (gamma 2.2), `white` and above being white; NaN is missing."""
    share = np.clip(np.nan_to_num(intensity) / np.float32(white), 0.0, 1.0)
    return _paint_missing(_gamma()[(share * 4095).astype(np.uint16)], np.isnan(intensity))


def depth(z: np.ndarray, limits: tuple[float, float] | None = None) -> np.ndarray:
    """Depth in metres, near red and far blue, even steps of 1/z; NaN is missing.

    limits: nearest and farthest depth of the colour range, to share it between pictures; by default that
    of `depth_limits`.
    """
    near, far = depth_limits(z) if limits is None else limits
    with np.errstate(divide="ignore"):
        return _mapped(1.0 / np.asarray(z, np.float32), "turbo", 1.0 / far, 1.0 / near)


def depth_limits(*depths: np.ndarray) -> tuple[float, float]:
    """Depths between which 96 % of all values lie, never equal; (1, 2) where there is none."""
    finite = np.concatenate([z[np.isfinite(z) & (z > 0)].ravel() for z in depths])
    if finite.size == 0:
        return 1.0, 2.0
    near, far = (float(v) for v in np.percentile(finite, (2, 98)))
    return (near, far) if far > near else (0.99 * near, 1.01 * near)


def normals(normal: np.ndarray) -> np.ndarray:
    """Unit normals H×W×3 in the camera frame: red right, green up, blue toward the camera; NaN is missing."""
    colours = 127.5 * (1.0 + np.nan_to_num(normal) * np.float32((1, -1, -1)))
    return _paint_missing(np.clip(colours, 0, 255).astype(np.uint8), np.isnan(normal).any(axis=-1))


def aolp(angle: np.ndarray) -> np.ndarray:
    """AoLP as hue with period π: red 0°, green 60°, blue 120°. See `aolp_wheel`; NaN is missing."""
    return _paint_missing(_hues()[_hue_index(angle)], np.isnan(angle))


def dolp(degree: np.ndarray, full: float = 1.0) -> np.ndarray:
    """DoLP from 0, black, to `full` and above, yellow."""
    return _mapped(degree, "inferno", 0.0, full)


def polarization(angle: np.ndarray, degree: np.ndarray, full: float = 1.0) -> np.ndarray:
    """AoLP as hue and DoLP as brightness: unpolarized light is black, `full` and above has full colour."""
    share = np.clip(np.nan_to_num(degree) / np.float32(full), 0.0, 1.0)
    return (_hues()[_hue_index(angle)] * share[..., None]).astype(np.uint8)


def aolp_wheel(size: int = 96) -> np.ndarray:
    """Legend of `aolp`: a disc on black, each direction in the colour of light polarized along it."""
    centre = (size - 1) / 2
    y, x = np.mgrid[:size, :size] - centre
    wheel = aolp(np.arctan2(y, x) % np.pi)
    wheel[np.hypot(x, y) > centre] = 0
    return wheel


def confidence(value: np.ndarray) -> np.ndarray:
    """Confidence from 0, dark blue, to 1, yellow; NaN is missing."""
    return _mapped(value, "viridis", 0.0, 1.0)


def error(value: np.ndarray, limit: float) -> np.ndarray:
    """Errors from 0, black, to `limit` and above, pale yellow, their sign dropped; NaN is missing."""
    return _mapped(np.abs(value), "magma", 0.0, limit)


def labels(label: np.ndarray) -> np.ndarray:
    """Kind of reflection, uint8: 0 none dark, 1 diffuse blue, 2 specular orange, 3 metal silver."""
    return np.array(LABEL_COLOURS, np.uint8)[label]


def origins(origin: np.ndarray) -> np.ndarray:
    """Where a depth comes from, uint8: 0 none dark, 1 stereo red, 2 propagated green, 3 estimated blue."""
    return np.array(ORIGIN_COLOURS, np.uint8)[origin]


def exposure(intensity: np.ndarray, saturated: np.ndarray, underexposed: np.ndarray) -> np.ndarray:
    """The grey image with clipped pixels in magenta and those that are too dark in blue."""
    picture = grey(intensity)
    picture[underexposed] = UNDEREXPOSED
    picture[saturated] = SATURATED
    return picture


def montage(pictures: Sequence[np.ndarray], columns: int | None = None, gap: int = 4) -> np.ndarray:
    """Pictures in rows of `columns` (all in one by default) on white, each at the top left of its cell."""
    columns = columns or len(pictures)
    rows = -(-len(pictures) // columns)
    height = max(p.shape[0] for p in pictures) + gap
    width = max(p.shape[1] for p in pictures) + gap
    sheet = np.full((rows * height - gap, columns * width - gap, 3), 255, np.uint8)
    for k, picture in enumerate(pictures):
        top, left = k // columns * height, k % columns * width
        sheet[top : top + picture.shape[0], left : left + picture.shape[1]] = picture
    return sheet


def _mapped(values: np.ndarray, colormap: str, low: float, high: float) -> np.ndarray:
    missing = np.isnan(values)
    share = (np.where(missing, low, values) - np.float32(low)) * np.float32(255.0 / (high - low))
    return _paint_missing(_table(colormap)[np.clip(share, 0, 255).astype(np.uint8)], missing)


def _paint_missing(picture: np.ndarray, missing: np.ndarray) -> np.ndarray:
    picture[missing] = MISSING
    return picture


def _hue_index(angle: np.ndarray) -> np.ndarray:
    return (np.nan_to_num(angle) * np.float32(256 / np.pi)).astype(np.int32) & 255


@lru_cache
def _table(colormap: str) -> np.ndarray:
    return np.round(255 * colormaps[colormap](np.arange(256))[:, :3]).astype(np.uint8)


@lru_cache
def _gamma() -> np.ndarray:
    levels = np.round(255 * (np.arange(4096) / 4095) ** (1 / 2.2)).astype(np.uint8)
    return np.repeat(levels[:, None], 3, axis=1)


@lru_cache
def _hues() -> np.ndarray:
    hue = np.arange(256) / 256
    return np.round(255 * hsv_to_rgb(np.stack([hue, np.ones(256), np.ones(256)], axis=-1))).astype(np.uint8)
