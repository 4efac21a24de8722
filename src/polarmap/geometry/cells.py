"""Cells that an image is cut into, squares of some pixels; borders are repeated where one sticks out."""

from __future__ import annotations

import cv2
import numpy as np

from polarmap.geometry.camera import PinholeCamera


def cell_means(image: np.ndarray, cell: int) -> np.ndarray:
    """Mean of each cell, float32 rows×columns or rows×columns×C. image: float32 H×W or H×W×C. cell: side in pixels."""
    rows, columns = -(-image.shape[0] // cell), -(-image.shape[1] // cell)
    bottom, right = rows * cell - image.shape[0], columns * cell - image.shape[1]
    padded = cv2.copyMakeBorder(image, 0, bottom, 0, right, cv2.BORDER_REPLICATE)
    return cv2.resize(padded, (columns, rows), interpolation=cv2.INTER_AREA)


def cell_minima(image: np.ndarray, cell: int) -> np.ndarray:
    """Least value of each cell, rows×columns, where nothing lies beyond the border. image: H×W, inf where none."""
    rows, columns = -(-image.shape[0] // cell), -(-image.shape[1] // cell)
    bottom, right = rows * cell - image.shape[0], columns * cell - image.shape[1]
    padded = np.pad(image, ((0, bottom), (0, right)), constant_values=np.inf)
    return padded.reshape(rows, cell, columns, cell).min(axis=(1, 3))


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
