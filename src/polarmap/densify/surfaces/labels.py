"""Which of a few surfaces each cell of an image belongs to: a Markov random field solved by belief propagation.

    E(l) = Σ_i c_i(l_i) + Σ_ij w_ij [l_i ≠ l_j]

Min-sum belief propagation with messages accelerated along rows and columns (Tappen and Freeman 2003): one sweep carries
a decision over the whole image, so that large areas without evidence of their own are decided by what lies around
them.
"""

from __future__ import annotations

import numpy as np
from numba import prange

from polarmap.jit import njit

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
    beliefs = costs + across[0] + across[1] + (along[0] + along[1]).transpose(1, 0, 2)
    return beliefs - beliefs.min(axis=2, keepdims=True)


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
    right, down = np.ascontiguousarray(right), np.ascontiguousarray(down.T)
    for _ in range(rounds):
        rest = costs + (along[0] + along[1]).transpose(1, 0, 2)
        _sweep_rows(rest, right, across)
        rest = turned + (across[0] + across[1]).transpose(1, 0, 2)
        _sweep_rows(rest, down, along)
    return across, along


def _merged(costs: np.ndarray) -> np.ndarray:
    """Sums over 2×2 cells."""
    rows, columns = costs.shape[0] % 2, costs.shape[1] % 2
    padded = np.pad(costs, ((0, rows), (0, columns), (0, 0)))
    return padded[::2, ::2] + padded[1::2, ::2] + padded[::2, 1::2] + padded[1::2, 1::2]


def _merged_across(right: np.ndarray) -> np.ndarray:
    """Costs of a change between merged cells and their right neighbours: those of the two pairs that touch."""
    padded = np.pad(right, ((0, right.shape[0] % 2), (0, right.shape[1] % 2)))
    return np.ascontiguousarray(padded[::2, 1::2] + padded[1::2, 1::2])


def _refined(messages: np.ndarray, rows: int, columns: int) -> np.ndarray:
    """Each merged cell's messages shared among its cells, so that what they cannot know is soon corrected."""
    fine = np.repeat(np.repeat(messages, 2, axis=1), 2, axis=2)[:, :rows, :columns]
    return np.ascontiguousarray(0.25 * fine, np.float32)


@njit(parallel=True)
def _sweep_rows(rest, weight, messages):
    """Messages along every row, forth and back; `rest` are the costs with the messages of the other direction."""
    rows, columns, _ = rest.shape
    for i in prange(rows):
        for j in range(1, columns):
            _send(rest[i, j - 1], messages[0, i, j - 1], weight[i, j - 1], messages[0, i, j])
        for j in range(columns - 2, -1, -1):
            _send(rest[i, j + 1], messages[1, i, j + 1], weight[i, j], messages[1, i, j])


@njit
def _send(rest, before, weight, message):
    """Update `message` by min(m, min m + w), with m the cost of the sender and what it heard from behind."""
    least = np.float32(np.inf)
    for k in range(rest.size):
        least = min(least, rest[k] + before[k])
    for k in range(rest.size):
        new = min(rest[k] + before[k] - least, weight)
        message[k] += (np.float32(1.0) - _KEPT) * (new - message[k])
