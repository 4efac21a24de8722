"""Whether raw pictures are what the camera file says of them: signs of a sensor that is read wrongly.

A colour sensor read as grey, blocks that begin a row or column further than the layout has them, angles in an order
that no layout has, a picture without polarization: each is as plain in the pixels as it is silent in the map.

Everything is judged in windows of 8×8 cells, over which a mean is far surer than a pixel, as shares of brightness:

Bayer filter         S0 of the blocks of a 2×2 group, less that of a plane: (a - b - c + d)/(a + b + c + d). It is 0 on
                     average in a picture, and (R - 2G + B)/(R + 2G + B) under a Bayer filter.
layout               I0 + I90 = I45 + I135, both pairs lying across the block's diagonals in every known layout.
begin of the blocks  Where a block's four pixels see one point, or lie under one colour, (I0 + I90) - (I45 + I135)
                     at edges is larger in blocks that begin one row or column too early. Where each sees its own, as
                     with a lens before a grey sensor, nothing tells how blocks begin, and nothing is said.
"""

from __future__ import annotations

from collections.abc import Iterable
from itertools import islice
from typing import TYPE_CHECKING

import numpy as np

from polarmap.data.sensor import SensorLayout

if TYPE_CHECKING:
    from polarmap.data.camera_file import CameraFile

_FRAMES = 5  # that are looked at
_SIDE = 2048  # pixels of a mosaic, about its middle, that are looked at
_WINDOW = 8  # cells a side
_LIT = 0.06  # of full scale, from which brightness is more than noise
_FEWEST_WINDOWS = 4
_PATTERN = 0.02  # of brightness: a pattern
_SURE = 4.0  # standard errors
_PATTERN_SHARE = 0.2  # of the windows
_GREY_SHARE = 0.01  # of the windows, below which there is no Bayer filter at all
_UNEQUAL = 0.03  # rms of the pairs' difference, of brightness, from which they do not measure one light
_UNEQUAL_RATIO = 2.0  # over that of another pairing
_FOREIGN = 0.15  # median of the difference, with one sign, that no polarizer makes
_UNPOLARIZED = 0.005  # DoLP that 90 % of the windows stay below
_STEEPEST = 0.3  # residual of a block that counts in full
_NO_RESIDUAL = 1e-6  # squared, of no concern
_LATER = 0.08  # logarithm of how much less another beginning of the blocks leaves


def check_mosaic(raw: Iterable[np.ndarray], camera_file: CameraFile) -> tuple[str, ...]:
    """What in raw pictures contradicts the camera file: one line for each finding, led by the key to set.

    raw: frames as recorded, uint8 or uint16, mosaics 2H×2W or four pictures 4×H×W, all of one kind; the first five
    are looked at. No finding means that nothing is seen to be wrong; of a plain camera there is none. Dark and clipped
    pixels do not count.
    """
    if not camera_file.polarized:
        return ()
    frames = [_light(_middle(picture), camera_file) for picture in islice(raw, _FRAMES)]
    mosaics = camera_file.layout is not None
    row, column = begin = _begin_of_blocks(frames) if mosaics else (0, 0)
    frames = [light[..., row:, column:] for light in frames]
    findings = [None if begin == (0, 0) else _shift_finding(begin, camera_file.layout)]
    findings.append(_bayer_finding(frames, camera_file))
    if not any(findings):
        findings.append(_pairing_finding(frames))
    if mosaics and not any(findings):
        findings.append(_unpolarized_finding(frames))
    return tuple(finding for finding in findings if finding)


def _middle(raw: np.ndarray) -> np.ndarray:
    """The middle of pictures, cut so that blocks and Bayer pattern begin as before."""
    top, left = (max(0, side - _SIDE) // 8 * 4 for side in raw.shape[-2:])
    return raw[..., top : top + _SIDE, left : left + _SIDE]


def _light(raw: np.ndarray, camera_file: CameraFile) -> np.ndarray:
    """Shares of full scale, float32, NaN where clipped."""
    black = np.float32(camera_file.black_level)
    light = (raw.astype(np.float32) - black) / (np.float32(camera_file.white_level) - black)
    light[raw >= camera_file.white_level - 1] = np.nan
    return light


def _pixels_of_blocks(light: np.ndarray) -> np.ndarray:
    """The four pixels of every block row by row, 4×H×W; of four pictures 0, 45, 135, 90, as a layout has them."""
    return light[[0, 1, 3, 2]] if light.ndim == 3 else _corners(light)


def _corners(image: np.ndarray) -> np.ndarray:
    height, width = (side // 2 * 2 for side in image.shape)
    image = image[:height, :width]
    return np.stack([image[::2, ::2], image[::2, 1::2], image[1::2, ::2], image[1::2, 1::2]])


_DIAGONAL, _COLUMNS, _ROWS = (1, -1, -1, 1), (1, -1, 1, -1), (1, 1, -1, -1)
_CROSS, _OTHER_CROSS = (1, 0, 0, -1), (0, 1, -1, 0)


def _contrasts(corners: np.ndarray, *signs: tuple[int, ...]) -> tuple[np.ndarray, ...]:
    """Signed sums of four values over their sum, each as (mean, standard error) of the windows, 2×N float32.

    corners: float32 4×H×W. Only windows all of whose values are lit and not clipped.
    """
    total = corners.sum(axis=0)
    total[total < 4 * _LIT] = np.nan
    found = []
    for sign in signs:
        part = np.tensordot(np.array(sign, np.float32), corners, axes=1) / total
        windows = _windows(part)
        whole = windows[np.isfinite(windows).all(axis=1)]
        found.append(np.stack([whole.mean(axis=1), whole.std(axis=1) / _WINDOW]))
    return tuple(found)


def _windows(image: np.ndarray) -> np.ndarray:
    """N×64 of the windows that fit."""
    rows, columns = image.shape[0] // _WINDOW, image.shape[1] // _WINDOW
    cut = image[: rows * _WINDOW, : columns * _WINDOW].reshape(rows, _WINDOW, columns, _WINDOW)
    return cut.transpose(0, 2, 1, 3).reshape(rows * columns, _WINDOW * _WINDOW)


def _pooled(corners: Iterable[np.ndarray], *signs: tuple[int, ...]) -> tuple[np.ndarray, ...]:
    """`_contrasts` over all frames, whose four values these are."""
    parts = [_contrasts(of_frame, *signs) for of_frame in corners]
    if not parts:
        return tuple(np.empty((2, 0)) for _ in signs)
    return tuple(np.concatenate(windows, axis=1) for windows in zip(*parts, strict=True))


def _bayer_finding(frames: list[np.ndarray], camera_file: CameraFile) -> str | None:
    groups = (_corners(_pixels_of_blocks(light).mean(axis=0)) for light in frames)
    means, errors = _pooled(groups, _DIAGONAL)[0]
    if means.size < _FEWEST_WINDOWS:
        return None
    share = float(((np.abs(means) > _PATTERN) & (np.abs(means) > _SURE * errors)).mean())
    if camera_file.colour is None and share > _PATTERN_SHARE:
        where = f"the brightness of 2x2 blocks alternates in {share:.0%} of the picture, as under a Bayer filter"
        if camera_file.layout is None:
            return f"colour: {where}; angles of a colour sensor must be converted to grey, or given as raw mosaics"
        return (
            f"colour: {where}; for a colour polarization sensor write colour: RGGB in the camera file "
            "(which of the four patterns makes no difference to the map)"
        )
    if camera_file.colour is not None and share < _GREY_SHARE:
        return (
            f"colour: no 4x4 pattern is seen, as a sensor under {camera_file.colour} would show it; "
            "for a grey sensor write colour: none"
        )
    return None


def _pairing_finding(frames: list[np.ndarray]) -> str | None:
    blocks = (_pixels_of_blocks(light) for light in frames)
    diagonal, *others = (windows[0] for windows in _pooled(blocks, _DIAGONAL, _COLUMNS, _ROWS))
    if diagonal.size < _FEWEST_WINDOWS:
        return None
    middle = float(np.median(diagonal))
    if abs(middle) > _FOREIGN:
        return (
            f"mosaic: I0 + I90 and I45 + I135 differ by {abs(middle):.0%} nearly everywhere, which light behind "
            "polarizers cannot; is this a polarization sensor's raw mosaic, and not an ordinary Bayer picture?"
        )
    difference, other = _rms(diagonal), min(map(_rms, others))
    if difference > _UNEQUAL and difference > _UNEQUAL_RATIO * other:
        return (
            "mosaic: the angles across a block's diagonal do not add up to one brightness, those in a row or column "
            "do; is the block given row by row, and the picture neither resized nor reordered?"
        )
    return None


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def _unpolarized_finding(frames: list[np.ndarray]) -> str | None:
    corners = (_apart_from_slopes(_corners(light)) for light in frames)
    first, second = (windows[0] for windows in _pooled(corners, _CROSS, _OTHER_CROSS))
    if first.size < _FEWEST_WINDOWS:
        return None
    usual = 2 * float(np.percentile(np.hypot(first, second), 90))
    if usual >= _UNPOLARIZED:
        return None
    return (
        f"mosaic: no polarization in the pictures (DoLP below {usual:.1%} in 90 % of them); are they the sensor's "
        "raw mosaics, and not grey pictures made of them?"
    )


def _apart_from_slopes(corners: np.ndarray) -> np.ndarray:
    """Corners of blocks 4×H×W at the places of the first two, where a slope of brightness makes no difference."""
    first, second, third, fourth = corners
    around_second = (third[1:, :-1] + third[1:, 1:] + third[:-1, :-1] + third[:-1, 1:]) / 4
    around_first = (fourth[1:, 1:] + fourth[:-1, 1:] + fourth[1:, :-1] + fourth[:-1, :-1]) / 4
    return np.stack([first[1:, 1:], second[1:, :-1], around_second, around_first])


def _shift_finding(begin: tuple[int, int], layout: SensorLayout) -> str:
    moved = {(0, 1): "one column", (1, 0): "one row", (1, 1): "one row and one column"}[begin]
    return (
        f"mosaic: the 2x2 blocks begin {moved} later than the camera file has them, as after a crop by an odd number; "
        f"crop by an even one, or write mosaic: {list(_moved(layout, begin))}"
    )


def _moved(layout: SensorLayout, begin: tuple[int, int]) -> tuple[int, ...]:
    """The layout of a picture whose first whole block begins at this row and column."""
    return tuple(int(a) for a in np.roll(np.reshape(layout.value, (2, 2)), begin, axis=(0, 1)).ravel())


def _begin_of_blocks(frames: list[np.ndarray]) -> tuple[int, int]:
    """Row and column at which the first whole block of mosaics begins; (0, 0) where nothing else is sure."""
    declared, *others = ((place, _residuals(frames, place)) for place in ((0, 0), (0, 1), (1, 0), (1, 1)))
    best, least = min(others, key=lambda other: np.nanmean(other[1]) if np.isfinite(other[1]).any() else np.inf)
    gain = np.log(declared[1] + _NO_RESIDUAL) - np.log(least + _NO_RESIDUAL)
    gain = gain[np.isfinite(gain)]
    if gain.size < _FEWEST_WINDOWS * len(frames) or not gain.size:
        return 0, 0
    error = gain.std() * np.sqrt(len(frames) / gain.size)  # the frames of a slow camera repeat each other
    return best if gain.mean() > max(_LATER, _SURE * error) else (0, 0)


def _residuals(frames: list[np.ndarray], place: tuple[int, int]) -> np.ndarray:
    """Mean square of (I0 + I90 - I45 - I135)/sum of each window of blocks that begin there, float32 N; NaN if dark."""
    residuals = []
    for light in frames:
        height, width = (side - 1 for side in light.shape)  # so that all beginnings have as many blocks
        corners = _corners(light[place[0] : place[0] + height, place[1] : place[1] + width])
        total = corners.sum(axis=0)
        total[total < 4 * _LIT] = np.nan
        difference = np.tensordot(np.array(_DIAGONAL, np.float32), corners, axes=1) / total
        windows = _windows(np.square(np.clip(difference, -_STEEPEST, _STEEPEST)))
        lit = np.isfinite(windows).mean(axis=1) > 0.5
        residuals.append(np.where(lit, np.nan_to_num(windows).mean(axis=1), np.nan))
    return np.concatenate(residuals) if residuals else np.empty(0)
