"""What the four channels measure of an even picture: means, and how sure they are."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from polarmap.data.camera_file import CameraFile
from polarmap.data.frame import Frame
from polarmap.data.sensor import AngleDirection
from polarmap.errors import InputError
from polarmap.sensing.mosaic import split

_CELL = 4  # pixels of a channel that the region's sides are a multiple of: whole Bayer blocks
_OUTLIER = 6.0  # standard deviations of a block's brightness: dust, a reflection
_EDGE = 4.0  # rms differences between neighbours
_TILES = 4  # parts a side
_MORE_THAN_NOISE = 3.0  # ratio of variances
_FEWEST = 64  # pixels of a channel


@dataclass(frozen=True, eq=False)
class ChannelMeans:
    """One picture, by its central half of each side.

    name: the picture's. values: means of the channels labelled 0, 45, 90 and 135 degrees, float64 4, pixel values.
    variances: of these means, float64 4. clipped, zero: shares of raw pixels at the top, and at 0.
    tiles: means of 4×4 parts of it, float64 4×16.
    """

    name: str
    values: np.ndarray
    variances: np.ndarray
    clipped: float
    zero: float
    tiles: np.ndarray

    def light(self, black: float, white: float) -> tuple[np.ndarray, np.ndarray]:
        """Means and their variances as shares of full scale, black level taken off."""
        scale = 1.0 / (white - black)
        return (self.values - black) * scale, self.variances * scale**2

    def unevenness(self, black: float) -> tuple[float, float]:
        """How much darker the darkest part is than the brightest, and the largest spread of a channel's share, rms."""
        light = np.maximum(self.tiles - black, 0.0)
        brightness = np.maximum(light.mean(axis=0), 1e-9)
        shares = light / brightness
        return float(1.0 - brightness.min() / brightness.max()), float(shares.std(axis=1).max())


def channel_means(frame: Frame, camera_file: CameraFile) -> ChannelMeans:
    """The means of a frame; blocks far from the usual brightness are left out.

    The variance of a pixel is measured, by differences between neighbours of one colour, which no slow change of
    brightness alters. Where the channels' shares of the brightness differ more than that between parts of the picture,
    it is the parts' variance. What rounding to whole values may do to a mean is added. Raises InputError where the
    picture is too small.
    """
    channels = _central(_labelled(frame, camera_file))
    if channels[0].size < _FEWEST:
        raise InputError(f"{frame.path}: too small to calibrate with; the middle holds {channels[0].size} blocks")
    kept = _usual(channels.mean(axis=0))
    values = np.array([channel[kept].mean(dtype=np.float64) for channel in channels])
    step = 2 if camera_file.colour is not None else 1
    pixel = np.array([_pixel_variance(channel, step) for channel in channels])
    tiles = _tile_means(channels, kept)
    noise = pixel / np.count_nonzero(kept)
    return ChannelMeans(
        name=frame.path.name,
        values=values,
        variances=np.maximum(noise, _tile_variance(tiles, noise)) + _rounding_variance(pixel),
        clipped=float(np.mean(channels >= camera_file.white_level - 1)),
        zero=float(np.mean(channels == 0)),
        tiles=tiles,
    )


def _labelled(frame: Frame, camera_file: CameraFile) -> np.ndarray:
    """The raw pixels of the channels as they are labelled, 4×H×W."""
    if camera_file.layout is None:
        return frame.raw
    return split(frame.raw, camera_file.layout, AngleDirection.CLOCKWISE)


def _central(channels: np.ndarray) -> np.ndarray:
    _, height, width = channels.shape
    rows, columns = (max(side // 2 // _CELL * _CELL, 0) for side in (height, width))
    top, left = (height - rows) // 2 // 2 * 2, (width - columns) // 2 // 2 * 2
    return channels[:, top : top + rows, left : left + columns]


def _usual(brightness: np.ndarray) -> np.ndarray:
    """Cells of 2×2 blocks whose brightness is not far from the median, bool H×W."""
    height, width = brightness.shape
    cells = brightness.reshape(height // 2, 2, width // 2, 2).mean(axis=(1, 3))
    away = np.abs(cells - np.median(cells))
    deviation = 1.4826 * np.median(away)
    return np.kron(away <= _OUTLIER * max(float(deviation), 0.5), np.ones((2, 2), bool))


def _tile_means(channels: np.ndarray, kept: np.ndarray) -> np.ndarray:
    """Means of 4×4 parts, float64 4×16; of a part of which nothing is kept, those of the whole."""
    whole = channels[:, kept].mean(axis=1, dtype=np.float64)
    height, width = kept.shape
    parts = []
    for rows in np.array_split(np.arange(height), _TILES):
        for columns in np.array_split(np.arange(width), _TILES):
            y, x = slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)
            values = channels[:, y, x][:, kept[y, x]]
            parts.append(values.mean(axis=1, dtype=np.float64) if values.size else whole)
    return np.stack(parts, axis=1)


def _tile_variance(tiles: np.ndarray, noise: np.ndarray) -> np.ndarray:
    """Of the channels' means, by the parts' shares of their brightness; 0 where that is what noise makes."""
    brightness = tiles.mean(axis=0)
    if brightness.min() <= 0:
        return np.zeros(4)
    shares = tiles / brightness * brightness.mean()
    found = shares.var(axis=1, ddof=1) / tiles.shape[1]
    return np.where(found > _MORE_THAN_NOISE * noise, found, 0.0)


def _pixel_variance(channel: np.ndarray, step: int) -> float:
    """By the mean square of differences to the right, without those that are edges."""
    square = (channel[:, step:].astype(np.float64) - channel[:, :-step]) ** 2
    return 0.5 * float(square[square <= _EDGE**2 * square.mean()].mean())


def _rounding_variance(pixel_variance: np.ndarray) -> np.ndarray:
    """Of the mean of rounded values: with noise σ it is off by up to exp(-2π²σ²)/π (Widrow and Kollár, 2008)."""
    return 0.5 * (np.exp(-2.0 * np.pi**2 * pixel_variance) / np.pi) ** 2
