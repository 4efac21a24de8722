"""What a picture looks like in a few figures, which tell a faulty one from its neighbours; for a millisecond or two."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from polarmap.data.sensor import SensorNoise
from polarmap.sensing.stokes import saturation_level

_CELLS_ACROSS = 80  # cells in a row of the picture
_SMALLEST_CELL = 4  # pixels
_NEAR, _FAR = 3, 12  # pixels; lags at which a picture is compared with itself
_LAPLACIAN = np.float32([[1, -2, 1], [-2, 4, -2], [1, -2, 1]])  # blind to slopes; Immerkær 1996
_MEDIAN_OF_NOISE = 6.0 * 0.6745  # |response| of that mask to noise of standard deviation 1
_CERTAIN = 5.0  # standard deviations
_NARROWED = 4  # columns taken together to look for a tear
_STEP = 2.5  # by which the difference between two rows exceeds those before and after it where there is a tear
_TINY = 1e-12


@dataclass(frozen=True, eq=False)
class FrameLook:
    """A picture in figures; intensities are shares of full scale.

    cells: mean intensity of square cells, float32 h×w. known: bool h×w, those that the lens shows.
    dark, clipped: bool h×w; nothing above the sensor's floor, or all at its ceiling.
    structure: variance of the means of 2×2 cells, times four, over that of the cells: 1 for noise, up to 4 for a
        picture, and 1 where nothing varies.
    correlation: of pixels three apart: 0 for noise, near 1 for a picture, and 1 where nothing varies.
    variance: of the pixels. noise: standard deviation of a pixel's noise, estimated from the picture.
    expected_noise: the same by the sensor's model, at the picture's mean.
    sharpness: how much of the change over a dozen pixels lies between neighbours, in the less sharp direction.
    fine: variance of the change between neighbours, without noise. contrast: variance of the change over a dozen
        pixels, in variances of noise.
    tear: by row, the share of columns that jump there and neither before nor after, upward and downward alike.
    """

    cells: np.ndarray
    known: np.ndarray
    dark: np.ndarray
    clipped: np.ndarray
    structure: float
    correlation: float
    variance: float
    noise: float
    expected_noise: float
    sharpness: float
    fine: float
    contrast: float
    tear: np.ndarray

    @property
    def mean(self) -> float:
        """Mean intensity of what the lens shows."""
        return float(self.cells[self.known].mean())

    @property
    def dark_share(self) -> float:
        """Of the cells that the lens shows."""
        return float(self.dark[self.known].mean())

    @property
    def clipped_share(self) -> float:
        """Of the cells that the lens shows."""
        return float(self.clipped[self.known].mean())


class FrameLooker:
    """Takes pictures to `FrameLook`.

    noise, bit_depth: the sensor's. valid: bool H×W, the pixels that the lens shows, all if None.
    """

    def __init__(self, noise: SensorNoise, bit_depth: int, valid: np.ndarray | None = None) -> None:
        self._noise, self._bit_depth = noise, bit_depth
        self._valid = valid if valid is not None and not valid.all() else None

    def __call__(self, intensity: np.ndarray) -> FrameLook:
        """The figures of an intensity, float32 H×W, of 16×16 pixels at least."""
        size = max(_SMALLEST_CELL, intensity.shape[1] // _CELLS_ACROSS)
        cells, known = cell_means(intensity, size), self._known(intensity.shape, size)
        pairs = cell_means(cells, 2)
        pairs_known = _all_of_four(known)
        small, large = _variance(cells[known]), _variance(pairs[pairs_known])
        changes = {lag: self._changes(intensity, lag) for lag in (1, _NEAR, _FAR)}
        variance = _variance(intensity[::8] if self._valid is None else intensity[::8][self._valid[::8]])
        noise = self._noise_in(intensity)
        fine, far = (np.maximum(changes[lag] - noise**2, 0.0) for lag in (1, _FAR))
        mean = float(cells[known].mean()) if known.any() else 0.0
        dark, clipped = self._ends(intensity, cells, size)
        return FrameLook(
            cells=cells,
            known=known,
            dark=dark,
            clipped=clipped,
            structure=4.0 * large / small if small > _TINY else 1.0,
            correlation=1.0 - float(changes[_NEAR].max()) / variance if variance > _TINY else 1.0,
            variance=variance,
            noise=noise,
            expected_noise=float(np.sqrt(self._noise.variance(np.float32(mean), self._bit_depth))),
            sharpness=float((fine / np.maximum(far, _TINY)).min()),
            fine=float(fine.min()),
            contrast=float(far.min()) / max(noise**2, float(self._floor()), _TINY),
            tear=self._tear(intensity, noise),
        )

    def _floor(self) -> np.float32:
        """Variance of a pixel without light."""
        return self._noise.variance(np.float32(0.0), self._bit_depth)

    def _known(self, shape: tuple[int, int], size: int) -> np.ndarray:
        if self._valid is None:
            return np.ones((shape[0] // size, shape[1] // size), bool)
        return cell_means(self._valid.astype(np.float32), size) > 0.999

    def _ends(self, intensity: np.ndarray, cells: np.ndarray, size: int) -> tuple[np.ndarray, np.ndarray]:
        """Cells without light, and those all of whose pixels are at the ceiling.

        Noise that is cut off at 0 has a mean of 0.4 standard deviations, so one of them is not yet light.
        """
        sigma = float(np.sqrt(self._floor()))
        ceiling = (intensity >= np.float32(saturation_level(self._bit_depth))).astype(np.float32)
        return cells < sigma * (1.0 + _CERTAIN / size), cell_means(ceiling, size) > 0.9

    def _changes(self, intensity: np.ndarray, lag: int) -> np.ndarray:
        """Half the mean square change over a lag, across and down, float64; every fourth row is looked at."""
        rows, below = intensity[:-lag:4], intensity[lag::4]
        across, down = rows[:, lag:] - rows[:, :-lag], below[: len(rows)] - rows
        if self._valid is None:
            return 0.5 * np.array([_mean_square(across), _mean_square(down)])
        shown, shown_below = self._valid[:-lag:4], self._valid[lag::4]
        both = shown[:, lag:] & shown[:, :-lag], shown_below[: len(rows)] & shown
        return 0.5 * np.array([_mean_square(d[b]) for d, b in zip((across, down), both, strict=True)])

    def _noise_in(self, intensity: np.ndarray) -> float:
        """Standard deviation of a pixel's noise where the picture is smooth, which is so in most places."""
        middle = intensity.shape[0] // 8
        response = np.concatenate(
            [cv2.filter2D(intensity[row : row + 10], -1, _LAPLACIAN)[1:-1:2, 1:-1:2] for row in self._bands(middle)]
        )
        return float(np.median(np.abs(response))) / _MEDIAN_OF_NOISE

    @staticmethod
    def _bands(eighth: int) -> range:
        return range(eighth // 2, 8 * eighth - 10, max(eighth, 10))

    def _tear(self, intensity: np.ndarray, noise: float) -> np.ndarray:
        """See `FrameLook.tear`; float64 H-3, of the step from row i+1 to row i+2."""
        height, width = intensity.shape
        narrow = cv2.resize(intensity, (width // _NARROWED, height), interpolation=cv2.INTER_AREA)
        step = cv2.subtract(narrow[1:], narrow[:-1])
        size = cv2.absdiff(narrow[1:], narrow[:-1])
        least = _CERTAIN * max(noise, float(np.sqrt(self._floor()))) / _NARROWED**0.5
        alone = size[1:-1] > _STEP * cv2.max(size[:-2], size[2:]) + np.float32(least)
        up = step[1:-1] > 0
        return np.minimum(*(np.count_nonzero(alone & side, axis=1) for side in (up, ~up))) / narrow.shape[1]


def cell_means(image: np.ndarray, size: int) -> np.ndarray:
    """Means of the square cells of a float32 H×W image, float32 H//size×W//size; what is left over is not counted."""
    height, width = image.shape[0] // size, image.shape[1] // size
    return cv2.resize(image[: height * size, : width * size], (width, height), interpolation=cv2.INTER_AREA)


def _all_of_four(known: np.ndarray) -> np.ndarray:
    height, width = known.shape[0] // 2, known.shape[1] // 2
    return known[: 2 * height, : 2 * width].reshape(height, 2, width, 2).all(axis=(1, 3))


def _variance(values: np.ndarray) -> float:
    return float(values.var(dtype=np.float64)) if values.size else 0.0


def _mean_square(values: np.ndarray) -> float:
    return float(cv2.norm(np.ascontiguousarray(values), cv2.NORM_L2SQR)) / values.size if values.size else 0.0
