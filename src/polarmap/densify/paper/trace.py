"""Walk from pixels without depth to the nearest pixels with depth, along a direction field.

Both of the paper's ways to spread depth (Section III-D) are such walks: along iso-depth contours nothing changes
(propagation); along the azimuth the log range changes by the gradient met on the way (estimation). The paper walks
from the known pixels outward; walking from the unknown ones inward follows the same curves, and lets every pixel be
computed by itself.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import prange

from polarmap.jit import njit


@dataclass(frozen=True)
class Arrivals:
    """What the walks from unknown pixels brought back, float32 H×W, NaN where no walk arrived.

    log_range: mean of the two ends' log range, weighted by 1/distance. distance: pixels to the nearer end, and from
    there on to the stereo point that it came from.
    """

    log_range: np.ndarray
    distance: np.ndarray


def trace(
    log_range: np.ndarray,
    distance: np.ndarray,
    direction: np.ndarray,
    gradient: np.ndarray | None,
    barrier: np.ndarray,
    max_turn: float,
    max_steps: int,
) -> Arrivals:
    """Log range of unknown pixels from the known ones that their two walks reach.

    log_range: float32 H×W, NaN where unknown; distance: float32 H×W pixels, 0 at stereo points.
    direction: float32 H×W×2 unit vectors (either sign), NaN where no walk may pass.
    gradient: float32 H×W×2 change of log range per pixel; None on contours, along which there is none.
    barrier: bool H×W, pixels that no walk enters or starts from.
    max_turn: radians between the directions of successive pixels, above which a walk ends. max_steps: pixels.
    """
    arrived = Arrivals(np.full_like(log_range, np.nan), np.full_like(log_range, np.nan))
    integrate = gradient is not None
    field = gradient if integrate else direction
    min_cosine = np.float32(np.cos(max_turn))
    _trace(
        log_range, distance, direction, field, integrate, barrier, min_cosine, max_steps,
        arrived.log_range, arrived.distance,
    )  # fmt: skip
    return arrived


@njit
def _walk(log_range, direction, gradient, integrate, barrier, min_cosine, max_steps, u, v, sign):
    """(log range at (u, v), steps, column, line) of the first known pixel on one side; 0 steps if there is none."""
    height, width = log_range.shape
    du = sign * direction[v, u, 0]
    dv = sign * direction[v, u, 1]
    x = np.float32(u)
    y = np.float32(v)
    column = np.int64(u)
    line = np.int64(v)
    change = np.float32(0.0)
    for step in range(1, max_steps + 1):
        x += du
        y += dv
        next_column = np.int64(np.floor(x + np.float32(0.5)))
        next_line = np.int64(np.floor(y + np.float32(0.5)))
        if next_column < 0 or next_line < 0 or next_column >= width or next_line >= height:
            break
        if barrier[next_line, next_column]:
            break
        if integrate:
            gu = gradient[line, column, 0] + gradient[next_line, next_column, 0]
            gv = gradient[line, column, 1] + gradient[next_line, next_column, 1]
            change += np.float32(0.5) * (gu * du + gv * dv)
        column = next_column
        line = next_line
        turn = du * direction[line, column, 0] + dv * direction[line, column, 1]
        if np.isnan(change) or not abs(turn) >= min_cosine:
            break
        if not np.isnan(log_range[line, column]):
            return log_range[line, column] - change, step, column, line
        flip = np.float32(1.0) if turn > 0 else np.float32(-1.0)
        du = flip * direction[line, column, 0]
        dv = flip * direction[line, column, 1]
    return np.float32(0.0), 0, column, line


@njit(parallel=True)
def _trace(
    log_range, distance, direction, gradient, integrate, barrier, min_cosine, max_steps, new_range, new_distance
):
    height, width = log_range.shape
    for v in prange(height):
        for u in range(width):
            if not np.isnan(log_range[v, u]) or barrier[v, u] or np.isnan(direction[v, u, 0]):
                continue
            total = np.float32(0.0)
            weight = np.float32(0.0)
            nearest = np.float32(np.inf)
            for side in range(2):
                value, steps, column, line = _walk(
                    log_range, direction, gradient, integrate, barrier, min_cosine, max_steps, u, v,
                    np.float32(1.0 - 2.0 * side),
                )  # fmt: skip
                if steps > 0:
                    length = np.float32(steps) + distance[line, column]
                    total += value / length
                    weight += np.float32(1.0) / length
                    nearest = min(nearest, length)
            if weight > 0:
                new_range[v, u] = total / weight
                new_distance[v, u] = nearest
