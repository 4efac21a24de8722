"""Signed distances to the nearest occupied voxel."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import distance_transform_edt

from polarmap.export.occupancy import OCCUPIED, UNKNOWN

UNOBSERVED = 1000.0
"""The value of voxels that no camera saw, as nvblox has it in its distance slices."""


def signed_distances(state: np.ndarray, voxel_size: float, truncation: float) -> np.ndarray:
    """Distances, float32 of the shape of `state`, in the unit of `voxel_size`, at most `truncation` on either side.

    Positive in free voxels, from centre to centre of the nearest occupied one (`truncation` where none is as near); 0
    in occupied voxels with a neighbour that is not, negative deeper inside; `UNOBSERVED` in unknown ones.
    """
    occupied = state == OCCUPIED
    found = np.full(state.shape, truncation, np.float32)
    if occupied.any():
        _fill(found, ~occupied, voxel_size, 0.0)
        _fill(found, occupied, -voxel_size, 1.0)
    np.clip(found, -truncation, truncation, out=found)
    found[state == UNKNOWN] = UNOBSERVED
    return found


def _fill(found: np.ndarray, where: np.ndarray, scale: float, less: float) -> None:
    """Give the voxels `where` (number of voxels to the nearest that is not, minus `less`) times `scale`.

    Layer by layer, since SciPy would take several times the memory for all distances at once.
    """
    if where.all():
        return
    nearest = distance_transform_edt(where, return_distances=False, return_indices=True)
    y, z = np.meshgrid(*(np.arange(size, dtype=np.float32) for size in where.shape[1:]), indexing="ij")
    for x in range(where.shape[0]):
        squared = (nearest[0, x] - np.float32(x)) ** 2 + (nearest[1, x] - y) ** 2 + (nearest[2, x] - z) ** 2
        layer = where[x]
        found[x][layer] = np.float32(scale) * (np.sqrt(squared[layer]) - np.float32(less))
