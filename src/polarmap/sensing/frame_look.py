"""What a picture looks like in a few figures, which tell a faulty one from its neighbours; for a millisecond or two."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from polarmap.data.sensor import SensorNoise
from polarmap.jit import FAST_MATH, njit
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
_ALL = np.zeros((0, 0), bool)  # pixels, where none is left out


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
        below = np.nextafter(np.float32(saturation_level(self._bit_depth)), np.float32(0.0))
        ceiling = cv2.threshold(intensity, float(below), 1.0, cv2.THRESH_BINARY)[1]
        return cells < sigma * (1.0 + _CERTAIN / size), cell_means(ceiling, size) > 0.9

    def _changes(self, intensity: np.ndarray, lag: int) -> np.ndarray:
        """Half the mean square change over a lag, across and down, float64; every fourth row is looked at."""
        valid = _ALL if self._valid is None else self._valid
        return 0.5 * np.array(_mean_square_changes(intensity, lag, valid))

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
        least = _CERTAIN * max(noise, float(np.sqrt(self._floor()))) / _NARROWED**0.5
        counts = np.zeros((2, height - 3), np.int64)
        _count_jumps(narrow, np.float32(least), counts)
        return np.minimum(*counts) / narrow.shape[1]


@njit
def _count_jumps(picture, least, counts):
    """How many columns step down and up between the rows i + 1 and i + 2, and hardly between those before and after."""
    ratio = np.float32(_STEP)
    for i in range(counts.shape[1]):
        a, b, c, d = picture[i], picture[i + 1], picture[i + 2], picture[i + 3]
        down, up = 0, 0
        for u in range(a.size):
            step = c[u] - b[u]
            alone = abs(step) > ratio * max(abs(b[u] - a[u]), abs(d[u] - c[u])) + least
            up += alone & (step > 0)
            down += alone & (step <= 0)
        counts[0, i], counts[1, i] = up, down


def cell_means(image: np.ndarray, size: int) -> np.ndarray:
    """Means of the square cells of a float32 H×W image, float32 H//size×W//size; what is left over is not counted."""
    height, width = image.shape[0] // size, image.shape[1] // size
    return cv2.resize(image[: height * size, : width * size], (width, height), interpolation=cv2.INTER_AREA)


def _all_of_four(known: np.ndarray) -> np.ndarray:
    height, width = known.shape[0] // 2, known.shape[1] // 2
    return known[: 2 * height, : 2 * width].reshape(height, 2, width, 2).all(axis=(1, 3))


def _variance(values: np.ndarray) -> float:
    return float(values.var(dtype=np.float64)) if values.size else 0.0


@njit(fastmath=FAST_MATH)
def _mean_square_changes(picture, lag, valid):
    """Across and down, of every fourth row, between pixels that are both `valid`, bool H×W, or all if that is empty."""
    height, width = picture.shape
    sums, counts = np.zeros(2), np.zeros(2)
    for v in range(0, height - lag, 4):
        here, below = picture[v], picture[v + lag]
        right = here[lag:]
        across, down = np.float32(0.0), np.float32(0.0)
        if valid.size == 0:
            for u in range(right.size):
                across += (right[u] - here[u]) ** 2
            for u in range(width):
                down += (below[u] - here[u]) ** 2
            counts[0] += right.size
            counts[1] += width
        else:
            for u in range(width):
                if valid[v, u] and u + lag < width and valid[v, u + lag]:
                    across += (here[u + lag] - here[u]) ** 2
                    counts[0] += 1
                if valid[v, u] and valid[v + lag, u]:
                    down += (below[u] - here[u]) ** 2
                    counts[1] += 1
        sums[0] += across
        sums[1] += down
    return sums[0] / max(counts[0], 1.0), sums[1] / max(counts[1], 1.0)
