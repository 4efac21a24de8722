"""Which of a few surfaces each cell of an image belongs to: a Markov random field solved by belief propagation.

    E(l) = Σ_i c_i(l_i) + Σ_ij w_ij [l_i ≠ l_j]

Min-sum belief propagation with messages accelerated along rows and columns (Tappen and Freeman 2003): one sweep carries
a decision over the whole image, so that large areas without evidence of their own are decided by what lies around
them.
"""

from __future__ import annotations

import numpy as np
from numba import prange

from polarmap.jit import FINITE_MATH, njit

_KEPT = np.float32(0.3)  # share of the old message that damps a new one
_COARSEST = 12  # cells along the shorter side of the coarsest grid


def label_cells(costs: np.ndarray, right: np.ndarray, down: np.ndarray, rounds: int = 8) -> np.ndarray:
    """Beliefs b_i(l), the cost of the best labelling in which cell i has label l, up to one constant per cell.

    costs: c, float32 rows×columns×L. right, down: w to the right and lower neighbour, float32 rows×columns, what lies
    beyond the border is ignored. rounds: of sweeps on each grid. Returns float32 rows×columns×L, 0 for the best label
    of each cell.

    Grids of half the size are solved first, and give the messages to begin with (Felzenszwalb and Huttenlocher 2006).
    """
    costs = np.ascontiguousarray(costs, np.float32)
    across, along = _messages(costs, right, down, rounds)
    beliefs = np.empty_like(costs)
    _add_messages(costs, across, along, beliefs)
    return beliefs


def best_labels(beliefs: np.ndarray) -> np.ndarray:
    """The label of least belief, the first of several, int16 rows×columns. beliefs: float32 rows×columns×L."""
    best = np.empty(beliefs.shape[:2], np.int16)
    _best_labels(beliefs, best)
    return best


def _messages(costs, right, down, rounds) -> tuple[np.ndarray, np.ndarray]:
    """From the left and the right, 2×rows×columns×L, and from above and below, transposed: 2×columns×rows×L."""
    rows, columns, labels = costs.shape
    if min(rows, columns) < 2 * _COARSEST:
        across, along = (
            np.zeros((2, rows, columns, labels), np.float32),
            np.zeros((2, columns, rows, labels), np.float32),
        )
    else:
        across, along = _messages(_merged(costs), _merged_across(right), _merged_across(down.T).T, rounds)
        across, along = _refined(across, rows, columns), _refined(along, columns, rows)
    turned = np.ascontiguousarray(costs.transpose(1, 0, 2))
    right, down = np.ascontiguousarray(right, np.float32), np.ascontiguousarray(down.T, np.float32)
    rest, rest_turned = np.empty_like(costs), np.empty_like(turned)
    for _ in range(rounds):
        _sweep_rows(costs, along, right, across, rest)
        _sweep_rows(turned, across, down, along, rest_turned)
    return across, along


def _merged(costs: np.ndarray) -> np.ndarray:
    """Sums over 2×2 cells."""
    rows, columns, labels = costs.shape
    merged = np.zeros(((rows + 1) // 2, (columns + 1) // 2, labels), np.float32)
    _add_fours(costs, merged)
    return merged


def _merged_across(right: np.ndarray) -> np.ndarray:
    """Costs of a change between merged cells and their right neighbours: those of the two pairs that touch."""
    padded = np.pad(right, ((0, right.shape[0] % 2), (0, right.shape[1] % 2)))
    return np.ascontiguousarray(padded[::2, 1::2] + padded[1::2, 1::2])


def _refined(messages: np.ndarray, rows: int, columns: int) -> np.ndarray:
    """Each merged cell's messages shared among its cells, so that what they cannot know is soon corrected."""
    fine = np.empty((2, rows, columns, messages.shape[3]), np.float32)
    _share_out(messages, fine)
    return fine


@njit(parallel=True)
def _add_fours(costs, merged):
    rows, columns, labels = costs.shape
    for i in prange(merged.shape[0]):
        for v in range(2 * i, min(2 * i + 2, rows)):
            for u in range(columns):
                for k in range(labels):
                    merged[i, u // 2, k] += costs[v, u, k]


@njit(parallel=True)
def _share_out(messages, fine):
    _, rows, columns, labels = fine.shape
    for v in prange(rows):
        for side in range(2):
            for u in range(columns):
                for k in range(labels):
                    fine[side, v, u, k] = np.float32(0.25) * messages[side, v // 2, u // 2, k]


@njit(parallel=True, fastmath=FINITE_MATH)
def _sweep_rows(costs, crossing, weight, messages, rest):
    """Messages along every row, forth and back. crossing: those of the other direction, 2×columns×rows×L. rest: room
    for what a cell has of its own and from there.
    """
    rows, columns, labels = costs.shape
    for i in prange(rows):
        for j in range(columns):
            for k in range(labels):
                rest[i, j, k] = costs[i, j, k] + (crossing[0, j, i, k] + crossing[1, j, i, k])
        for j in range(1, columns):
            _send(rest[i, j - 1], messages[0, i, j - 1], weight[i, j - 1], messages[0, i, j])
        for j in range(columns - 2, -1, -1):
            _send(rest[i, j + 1], messages[1, i, j + 1], weight[i, j], messages[1, i, j])


@njit(fastmath=FINITE_MATH)
def _send(rest, before, weight, message):
    """Update `message` by min(m, min m + w), with m the cost of the sender and what it heard from behind."""
    least = np.float32(np.finfo(np.float32).max)
    for k in range(rest.size):
        least = min(least, rest[k] + before[k])
    for k in range(rest.size):
        new = min(rest[k] + before[k] - least, weight)
        message[k] += (np.float32(1.0) - _KEPT) * (new - message[k])


@njit(parallel=True, fastmath=FINITE_MATH)
def _add_messages(costs, across, along, beliefs):
    """What a cell has of its own and all it hears, less the least of that."""
    rows, columns, labels = costs.shape
    for i in prange(rows):
        for j in range(columns):
            least = np.float32(np.finfo(np.float32).max)
            for k in range(labels):
                heard = across[0, i, j, k] + across[1, i, j, k] + (along[0, j, i, k] + along[1, j, i, k])
                beliefs[i, j, k] = costs[i, j, k] + heard
                least = min(least, beliefs[i, j, k])
            for k in range(labels):
                beliefs[i, j, k] -= least


@njit(parallel=True)
def _best_labels(beliefs, best):
    rows, columns, labels = beliefs.shape
    for i in prange(rows):
        for j in range(columns):
            least = 0
            for k in range(1, labels):
                if beliefs[i, j, k] < beliefs[i, j, least]:
                    least = k
            best[i, j] = least
