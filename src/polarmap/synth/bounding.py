"""A tree of bounding spheres, so that a ray is tested against few of a scene's primitives.

The nodes lie in depth-first order; each holds the number of nodes of its subtree, which a ray that misses its sphere
leaps over. No stack is needed.
"""

from __future__ import annotations

import numpy as np

NODE = np.dtype(
    [
        ("centre", np.float64, (3,)),
        ("bound", np.float64),  # squared radius
        ("primitive", np.int64),  # -1 for a node with others below it
        ("leap", np.int64),  # nodes of the subtree, this one included
    ]
)
_LARGE = 3.0  # times the median radius; larger spheres would only bloat those above them


def bounding_tree(centres: np.ndarray, radii: np.ndarray) -> np.ndarray:
    """NODE array over spheres, N×3 and N; those much larger than most stand by themselves."""
    if len(radii) == 0:
        return np.empty(0, NODE)
    large = ~(radii <= _LARGE * np.median(radii))
    rows = [row for i in np.flatnonzero(large) for row in _subtree(centres, radii, np.array([i]))]
    if not large.all():
        rows += _subtree(centres, radii, np.flatnonzero(~large))
    return np.array(rows, NODE)


def _subtree(centres: np.ndarray, radii: np.ndarray, members: np.ndarray) -> list[tuple]:
    if len(members) == 1:
        i = int(members[0])
        return [(centres[i], radii[i] ** 2, i, 1)]
    extent = np.ptp(centres[members], axis=0)
    order = members[np.argsort(centres[members, np.argmax(extent)], kind="stable")]
    half = len(order) // 2
    below = _subtree(centres, radii, order[:half]) + _subtree(centres, radii, order[half:])
    middle = (centres[members].min(axis=0) + centres[members].max(axis=0)) / 2
    radius = (np.linalg.norm(centres[members] - middle, axis=1) + radii[members]).max()
    return [(middle, radius**2, -1, 1 + len(below)), *below]
