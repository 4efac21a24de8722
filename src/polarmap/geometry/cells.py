"""Cells that an image is cut into, squares of some pixels; borders are repeated where one sticks out."""

from __future__ import annotations

import cv2
import numpy as np
from numba import prange

from polarmap.geometry.camera import PinholeCamera
from polarmap.jit import njit


def cell_means(image: np.ndarray, cell: int) -> np.ndarray:
    """Mean of each cell, float32 rows×columns or rows×columns×C. image: float32 H×W or H×W×C. cell: side in pixels."""
    rows, columns = -(-image.shape[0] // cell), -(-image.shape[1] // cell)
    bottom, right = rows * cell - image.shape[0], columns * cell - image.shape[1]
    padded = cv2.copyMakeBorder(image, 0, bottom, 0, right, cv2.BORDER_REPLICATE)
    return cv2.resize(padded, (columns, rows), interpolation=cv2.INTER_AREA)


def cell_minima(image: np.ndarray, cell: int) -> np.ndarray:
    """Least value of each cell, rows×columns, where nothing lies beyond the border. image: H×W, inf where none."""
    rows, columns = -(-image.shape[0] // cell), -(-image.shape[1] // cell)
    least = np.full((rows, columns), np.inf, image.dtype)
    _cell_minima(image, cell, least)
    return least


@njit(parallel=True)
def _cell_minima(image, cell, least):
    height, width = image.shape
    for i in prange(least.shape[0]):
        for v in range(i * cell, min((i + 1) * cell, height)):
            for j in range(least.shape[1]):
                for u in range(j * cell, min((j + 1) * cell, width)):
                    least[i, j] = min(least[i, j], image[v, u])


def middles_of(shape: tuple[int, int], cell: int) -> tuple[np.ndarray, np.ndarray]:
    """Rows and columns of the pixels in the middle of the cells."""
    return tuple(np.minimum(np.arange(0, size, cell) + cell // 2, size - 1) for size in shape)


def cell_camera(camera: PinholeCamera, cell: int) -> PinholeCamera:
    """The camera whose pixels are the cells."""
    shift = 0.5 * (cell - 1)
    return PinholeCamera(
        -(-camera.width // cell), -(-camera.height // cell), camera.fx / cell, camera.fy / cell,
        (camera.cx - shift) / cell, (camera.cy - shift) / cell,
    )  # fmt: skip
