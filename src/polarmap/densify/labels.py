"""Which of a few surfaces each cell of an image belongs to: a Markov random field solved by belief propagation.

    E(l) = Σ_i c_i(l_i) + Σ_ij w_ij [l_i ≠ l_j]

Min-sum belief propagation with messages accelerated along rows and columns (Tappen and Freeman 2003): one sweep carries
a decision over the whole image, so that large areas without evidence of their own are decided by what lies around
them.
"""

from __future__ import annotations

import numpy as np
from numba import njit, prange

_KEPT = np.float32(0.3)  # share of the old message that damps a new one


def label_cells(costs: np.ndarray, right: np.ndarray, down: np.ndarray, rounds: int = 8) -> np.ndarray:
    """Beliefs b_i(l), the cost of the best labelling in which cell i has label l, up to one constant per cell.

    costs: c, float32 rows×columns×L. right, down: w to the right and lower neighbour, float32 rows×columns, what lies
    beyond the border is ignored. Returns float32 rows×columns×L, 0 for the best label of each cell.
    """
    costs = np.ascontiguousarray(costs, np.float32)
    across = np.zeros((2, *costs.shape), np.float32)  # messages from the left and from the right
    along = np.zeros((2, *costs.shape[1::-1], costs.shape[2]), np.float32)  # from above and below, transposed
    turned = np.ascontiguousarray(costs.transpose(1, 0, 2))
    down = np.ascontiguousarray(down.T)
    for _ in range(rounds):
        rest = costs + (along[0] + along[1]).transpose(1, 0, 2)
        _sweep_rows(rest, right, across)
        rest = turned + (across[0] + across[1]).transpose(1, 0, 2)
        _sweep_rows(rest, down, along)
    beliefs = costs + across[0] + across[1] + (along[0] + along[1]).transpose(1, 0, 2)
    return beliefs - beliefs.min(axis=2, keepdims=True)


@njit(cache=True, parallel=True)
def _sweep_rows(rest, weight, messages):
    """Messages along every row, forth and back; `rest` are the costs with the messages of the other direction."""
    rows, columns, _ = rest.shape
    for i in prange(rows):
        for j in range(1, columns):
            _send(rest[i, j - 1], messages[0, i, j - 1], weight[i, j - 1], messages[0, i, j])
        for j in range(columns - 2, -1, -1):
            _send(rest[i, j + 1], messages[1, i, j + 1], weight[i, j], messages[1, i, j])


@njit(cache=True)
def _send(rest, before, weight, message):
    """Update `message` by min(m, min m + w), with m the cost of the sender and what it heard from behind."""
    least = np.float32(np.inf)
    for k in range(rest.size):
        least = min(least, rest[k] + before[k])
    for k in range(rest.size):
        new = min(rest[k] + before[k] - least, weight)
        message[k] += (np.float32(1.0) - _KEPT) * (new - message[k])
