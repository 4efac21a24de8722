"""From a mosaic of polarizer pixels to four channels: split, bilinear and edge-aware demosaicing.

Channels are float32 4×h×w in the order 0, 45, 90, 135 degrees of this project's convention (clockwise as
displayed). At the default half resolution h = H/2 and w = W/2, and pixel (u, v) of a channel is the 2×2
block centred at (2u + ½, 2v + ½) of the mosaic, whatever the method:

split        The block's four pixels as they are: no interpolation, but the four angles look at points up to
             √2 mosaic pixels apart, which makes false polarization at every intensity edge.
bilinear     Each angle interpolated linearly at the block's centre.
edge-aware   Each angle interpolated along a guide image that keeps edges (`_edge_aware_fields`).
"""

from __future__ import annotations

import numpy as np
from numba import prange

from polarmap.data.sensor import AngleDirection, SensorLayout
from polarmap.errors import InputError
from polarmap.jit import FAST_MATH, njit

METHODS = ("split", "bilinear", "edge-aware")

# Variance of a channel's value over that of one pixel: the sum of the squared interpolation weights.
_NOISE_GAIN = {"split": 1.0, "bilinear": (10 / 16) ** 2, "edge-aware": (10 / 16) ** 2}
_COLOUR_NOISE_GAIN = {"split": (6 / 16) ** 2, "bilinear": (84 / 256) ** 2, "edge-aware": (84 / 256) ** 2}

_EDGE_FLOOR = 0.02  # share of the intensity below which a difference is noise, not an edge
_SLOPE_PRIOR = 0.05  # contrast, as a share of the intensity, above which a slope is believed over the ratio
_DARK = 1e-4  # share of full scale; keeps the quotients finite where it is black
_EDGE_AWARE_MINIMUM = 6  # pixels a side: one 3×3 window of equal angles


def demosaic(
    mosaic: np.ndarray,
    layout: SensorLayout,
    method: str = "split",
    direction: AngleDirection = AngleDirection.CLOCKWISE,
    full_resolution: bool = False,
) -> np.ndarray:
    """The four channels of a grey polarizer mosaic, float32 4×(H/2)×(W/2), or 4×H×W at full resolution.

    mosaic: float32 H×W, linear in light (for a colour mosaic see `colour_to_grey`). full_resolution gives
    each angle at each mosaic pixel, for `bilinear` and `edge-aware`; the mean of its 2×2 blocks is the half
    resolution result. Raises InputError for an unknown method, an odd or too small size, or a full
    resolution split.
    """
    _check(mosaic, method, full_resolution)
    mosaic = np.ascontiguousarray(mosaic, np.float32)
    offsets = channel_offsets(layout, direction)
    if method == "split":
        return split(mosaic, layout, direction)
    if method == "bilinear":
        return _linear_at_pixels(mosaic, offsets) if full_resolution else _linear_at_blocks(mosaic, offsets)
    guide, slope, rest = _edge_aware_fields(mosaic)
    if full_resolution:
        return _linear_at_pixels(slope, offsets) * guide + _linear_at_pixels(rest, offsets)
    return _guided_at_blocks(guide, slope, rest, offsets)


def split(mosaic: np.ndarray, layout: SensorLayout, direction: AngleDirection = AngleDirection.CLOCKWISE) -> np.ndarray:
    """The pixels of each angle as an image of its own, any dtype, 4×(H/2)×(W/2)."""
    return np.stack([mosaic[y::2, x::2] for y, x in channel_offsets(layout, direction)])


def split_light(
    raw: np.ndarray, layout: SensorLayout, direction: AngleDirection, black: np.float32, scale: np.float32
) -> np.ndarray:
    """`split` of (raw - black) · scale, float32 4×(H/2)×(W/2). raw: any integers H×W."""
    out = np.empty((4, raw.shape[0] // 2, raw.shape[1] // 2), np.float32)
    _split_light(raw, channel_offsets(layout, direction), black, scale, out)
    return out


def mean_of_split_light(
    raw: np.ndarray, layout: SensorLayout, direction: AngleDirection, black: np.float32, scale: np.float32
) -> np.ndarray:
    """`stokes.mean_intensity` of `split_light`, to the last bit, float32 (H/2)×(W/2)."""
    out = np.empty((raw.shape[0] // 2, raw.shape[1] // 2), np.float32)
    places = channel_offsets(layout, direction) @ [2, 1]
    pairs = {int(a): int(b) for pair in (places[:2], places[2:]) for a, b in (pair, pair[::-1])}
    _mean_of_split_light(raw, pairs[0], black, scale, out)
    return out


def channel_offsets(layout: SensorLayout, direction: AngleDirection) -> np.ndarray:
    """Row and column in the 2×2 block of the channels 0, 45, 90, 135 degrees clockwise, int64 4×2."""
    sign = 1 if direction is AngleDirection.CLOCKWISE else -1
    places = [layout.value.index(sign * angle % 180) for angle in (0, 45, 90, 135)]
    return np.array([divmod(place, 2) for place in places])


def noise_gain(method: str, colour: bool = False) -> float:
    """Variance of a demosaiced channel over that of a mosaic pixel, from the interpolation weights.

    Exact for `split` and `bilinear`. For `edge-aware`, whose weights depend on the image, that of `bilinear`;
    on flat surfaces the variance of its S1 and S2 is a fifth less.
    """
    return (_COLOUR_NOISE_GAIN if colour else _NOISE_GAIN)[method]


def reach(method: str, colour: bool = False) -> int:
    """How many blocks away from its own a demosaiced value still takes samples."""
    return (method != "split") + colour


def colour_to_grey(mosaic: np.ndarray) -> np.ndarray:
    """Luminance mosaic of a colour polarizer mosaic (Bayer × polarizer, IMX250MYR and kin), float32 H×W.

    Each 2×2 polarizer block lies under one Bayer colour. The pixels of one angle make a Bayer image, whose
    demosaicing with (1 2 1)/4 ⊗ (1 2 1)/4 gives R/4 + G/2 + B/4 at every pixel whichever of the four Bayer
    patterns it is. Stokes vectors are linear in light, so a fixed mixture of colours has a true Stokes
    vector, and needs no white balance. Raises InputError where the size is no multiple of 4.
    """
    if mosaic.ndim != 2 or mosaic.shape[0] % 4 or mosaic.shape[1] % 4 or mosaic.size == 0:
        raise InputError(f"colour mosaic: size {_size(mosaic)} is no multiple of the 4x4 superpixel")
    return _binomial_of_equal_angles(np.ascontiguousarray(mosaic, np.float32))


def _check(mosaic: np.ndarray, method: str, full_resolution: bool) -> None:
    if method not in METHODS:
        raise InputError(f"demosaic: {method!r} is not one of {', '.join(METHODS)}")
    if mosaic.ndim != 2 or mosaic.size == 0 or mosaic.shape[0] % 2 or mosaic.shape[1] % 2:
        raise InputError(f"mosaic: size {_size(mosaic)} does not split into 2x2 polarizer blocks")
    if method == "split" and full_resolution:
        raise InputError("demosaic: split has no full resolution; use bilinear or edge-aware")
    if method == "edge-aware" and min(mosaic.shape) < _EDGE_AWARE_MINIMUM:
        raise InputError(f"mosaic: size {_size(mosaic)} is too small for edge-aware demosaicing; use bilinear")


def _size(mosaic: np.ndarray) -> str:
    return "x".join(str(n) for n in mosaic.shape[::-1])


def _edge_aware_fields(mosaic: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Guide G, slope a and rest m - a·G of each pixel, float32 H×W.

    A channel is then a·G + rest, with a and rest interpolated linearly from the channel's own pixels:
    residual interpolation (Kiku et al., ICIP 2013; Morimatsu et al., ICIP 2020, for polarization) in which
    the constant term of the local regression cancels.

    G is the grey image S0/2 at full resolution. Any 2×2 window holds each angle once, so its mean is S0/2
    at the window's centre; G is the mean of the four windows around a pixel, each weighed by 1/roughness²:
    windows across an edge hardly count. The roughness is the mean difference of equal angles two pixels
    apart. The slope is that of the regression of equal angles on G over a 3×3 neighbourhood of them, drawn
    towards their ratio, which does not change where reflectance does and polarization does not.
    """
    guide = _mean_of_windows(*_weigh_windows(mosaic, _roughness(mosaic)))
    slope = _slope(mosaic, guide)
    return guide, slope, mosaic - slope * guide


@njit(parallel=True)
def _split_light(raw, offsets, black, scale, out):
    """Unsigned places, which cannot mean the other end of a row, let it compile to vector instructions."""
    for y in prange(out.shape[1]):
        for k in range(4):
            row, right, line = raw[2 * y + offsets[k, 0]], np.uint64(offsets[k, 1]), out[k, y]
            for x in range(np.uint64(line.size)):
                line[x] = (np.float32(row[np.uint64(2) * x + right]) - black) * scale


@njit(parallel=True)
def _mean_of_split_light(raw, partner, black, scale, out):
    """partner: which pixel of the block, 1 to 3, is added to the first one before the two others."""
    quarter, zero = np.float32(0.25), np.float32(0.0)
    for y in prange(out.shape[0]):
        upper, lower, line = raw[2 * y], raw[2 * y + 1], out[y]
        for x in range(line.size):
            left = np.uint64(2) * np.uint64(x)
            right = left + np.uint64(1)
            a, b = (np.float32(upper[left]) - black) * scale, (np.float32(upper[right]) - black) * scale
            c, d = (np.float32(lower[left]) - black) * scale, (np.float32(lower[right]) - black) * scale
            total = (a + b) + (c + d) if partner == 1 else ((a + c) + (b + d) if partner == 2 else (a + d) + (b + c))
            line[x] = quarter * total if total > zero else zero


@njit(parallel=True)
def _roughness(mosaic):
    height, width = mosaic.shape
    out = np.empty((height, width), np.float32)
    for y in prange(height):
        y0 = min(max(y - 1, 0), height - 3)
        for x in range(width):
            x0 = min(max(x - 1, 0), width - 3)
            out[y, x] = abs(mosaic[y, x0 + 2] - mosaic[y, x0]) + abs(mosaic[y0 + 2, x] - mosaic[y0, x])
    return out


@njit(parallel=True, error_model="numpy", fastmath=FAST_MATH)
def _weigh_windows(mosaic, roughness):
    """Weight, and weight times mean, of the 2×2 window that ends at each pixel, (H+1)×(W+1), 0 outside."""
    height, width = mosaic.shape
    quarter, floor, dark = np.float32(0.25), np.float32(_EDGE_FLOOR), np.float32(_DARK)
    weight = np.zeros((height + 1, width + 1), np.float32)
    weighted = np.zeros((height + 1, width + 1), np.float32)
    for y in prange(height - 1):
        for x in range(width - 1):
            mean = mosaic[y, x] + mosaic[y, x + 1] + mosaic[y + 1, x] + mosaic[y + 1, x + 1]
            rough = roughness[y, x] + roughness[y, x + 1] + roughness[y + 1, x] + roughness[y + 1, x + 1]
            rough = quarter * (rough + floor * abs(mean)) + dark
            w = 1 / (rough * rough)
            weight[y + 1, x + 1] = w
            weighted[y + 1, x + 1] = w * quarter * mean
    return weight, weighted


@njit(parallel=True, error_model="numpy", fastmath=FAST_MATH)
def _mean_of_windows(weight, weighted):
    height, width = weight.shape[0] - 1, weight.shape[1] - 1
    out = np.empty((height, width), np.float32)
    for y in prange(height):
        for x in range(width):
            total = weighted[y, x] + weighted[y, x + 1] + weighted[y + 1, x] + weighted[y + 1, x + 1]
            out[y, x] = total / (weight[y, x] + weight[y, x + 1] + weight[y + 1, x] + weight[y + 1, x + 1])
    return out


@njit(parallel=True, error_model="numpy", fastmath=FAST_MATH)
def _slope(mosaic, guide):
    height, width = mosaic.shape
    ninth, prior = np.float32(1 / 9), np.float32(_SLOPE_PRIOR**2)
    out = np.empty((height, width), np.float32)
    for y in prange(height):
        # Near the border the window moves inward by whole blocks, so that it keeps to one angle.
        top = int(y) - 2
        top += 2 * (top < 0) - 2 * (top > height - 5)
        for x in range(width - 4):
            g = m = gg = gm = np.float32(0.0)
            for i in range(3):
                for j in range(3):
                    a, b = guide[top + 2 * i, x + 2 * j], mosaic[top + 2 * i, x + 2 * j]
                    g += a
                    m += b
                    gg += a * a
                    gm += a * b
            g *= ninth
            m *= ninth
            covariance = gm * ninth - g * m
            variance = max(gg * ninth - g * g, np.float32(0.0))
            out[y, x + 2] = (covariance + prior * g * m) / (variance + prior * g * g + np.float32(_DARK**2))
        out[y, :2] = out[y, 2:4]
        out[y, width - 2 :] = out[y, width - 4 : width - 2]
    return out


@njit(parallel=True, error_model="numpy", fastmath=FAST_MATH)
def _linear_at_blocks(mosaic, offsets):
    height, width = mosaic.shape[0] // 2, mosaic.shape[1] // 2
    out = np.empty((4, height, width), np.float32)
    for y in prange(height):
        for k in range(4):
            oy, ox = offsets[k]
            y0 = 2 * y + oy
            y1 = _other_side(y0, 2 * height)
            for x in range(width):
                x0 = 2 * x + ox
                x1 = _other_side(x0, 2 * width)
                near, far = 9 * mosaic[y0, x0], 3 * (mosaic[y0, x1] + mosaic[y1, x0]) + mosaic[y1, x1]
                out[k, y, x] = np.float32(1 / 16) * (near + far)
    return out


@njit(inline="always")
def _other_side(place, size):
    """The next pixel of the same angle on the other side of the block's centre; mirrored at the border."""
    other = place + 2 if place % 2 == 0 else place - 2
    return other if 0 <= other < size else place


@njit(parallel=True, error_model="numpy", fastmath=FAST_MATH)
def _linear_at_pixels(mosaic, offsets):
    height, width = mosaic.shape
    out = np.empty((4, height, width), np.float32)
    for y in prange(height):
        for k in range(4):
            oy, ox = offsets[k]
            y0, y1 = _neighbours(y, oy, height)
            for x in range(width):
                x0, x1 = _neighbours(x, ox, width)
                near, far = mosaic[y0, x0] + mosaic[y0, x1], mosaic[y1, x0] + mosaic[y1, x1]
                out[k, y, x] = np.float32(0.25) * (near + far)
    return out


@njit(inline="always")
def _neighbours(place, offset, size):
    """The two nearest pixels at `offset` in their block: itself twice, or one each side, inside the image."""
    odd = (place + offset) % 2
    before, after = place - odd, place + odd
    if before < 0:
        before = after
    if after >= size:
        after = before
    return before, after


@njit(parallel=True, error_model="numpy", fastmath=FAST_MATH)
def _guided_at_blocks(guide, slope, rest, offsets):
    """Mean over each block's four pixels of slope·guide + rest, both interpolated from equal angles."""
    height, width = guide.shape[0] // 2, guide.shape[1] // 2
    out = np.empty((4, height, width), np.float32)
    for y in prange(height):
        for k in range(4):
            oy, ox = offsets[k]
            y0 = 2 * y + oy
            y1 = _other_side(y0, 2 * height)
            across_y = 2 * y + 1 - oy
            for x in range(width):
                x0 = 2 * x + ox
                x1 = _other_side(x0, 2 * width)
                across_x = 2 * x + 1 - ox
                a00, a01, a10, a11 = slope[y0, x0], slope[y0, x1], slope[y1, x0], slope[y1, x1]
                total = (
                    4 * a00 * guide[y0, x0]
                    + 2 * (a00 + a01) * guide[y0, across_x]
                    + 2 * (a00 + a10) * guide[across_y, x0]
                    + (a00 + a01 + a10 + a11) * guide[across_y, across_x]
                )
                total += 9 * rest[y0, x0] + 3 * (rest[y0, x1] + rest[y1, x0]) + rest[y1, x1]
                out[k, y, x] = np.float32(1 / 16) * total
    return out


@njit(parallel=True)
def _binomial_of_equal_angles(mosaic):
    height, width = mosaic.shape
    out = np.empty((height, width), np.float32)
    for y in prange(height):
        up = y - 2 if y >= 2 else y + 2
        down = y + 2 if y + 2 < height else y - 2
        for x in range(width):
            left = x - 2 if x >= 2 else x + 2
            right = x + 2 if x + 2 < width else x - 2
            corners = mosaic[up, left] + mosaic[up, right] + mosaic[down, left] + mosaic[down, right]
            sides = mosaic[up, x] + mosaic[down, x] + mosaic[y, left] + mosaic[y, right]
            out[y, x] = np.float32(1 / 16) * (4 * mosaic[y, x] + 2 * sides + corners)
    return out
