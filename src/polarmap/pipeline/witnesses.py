"""What earlier keyframes have surely seen, of as many as say something new: they testify against surfaces later."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from polarmap.data.view import View, Witness
from polarmap.geometry.camera import PinholeCamera
from polarmap.geometry.sim3 import Sim3
from polarmap.pipeline.keyframe_rule import sample_points

_KEPT = 32  # witnesses, so that memory stays bounded
_CALLED = 10  # that are asked about a view
_EVERY = 4  # pixel of a witness in a row and a column that its median depth is taken of
_LEAST_SHARED = 0.1  # of what a view shows, that a witness must see


class Witnesses:
    """Keyframes that are no neighbours any more. Of two that see the same from about the same place, one is kept."""

    def __init__(self, camera: PinholeCamera) -> None:
        self._camera = camera
        self._kept: list[Witness] = []

    def __len__(self) -> int:
        return len(self._kept)

    def add(self, witness: Witness) -> None:
        """Take one more; with too many, the one least apart from another goes."""
        self._kept.append(witness)
        if len(self._kept) > _KEPT:
            del self._kept[int(_apart(self._kept)[:-1].min(axis=1).argmin())]

    def move(self, poses: Mapping[int, Sim3]) -> None:
        """Move keyframes to present poses, by index."""
        self._kept = [w.moved(poses[w.index]) if w.index in poses else w for w in self._kept]

    def called(self, view: View, last: View | None) -> tuple[Witness, ...]:
        """Those that see what the view shows, from directions as different as there are.

        last: the keyframe mapped last, whose depth tells what that may be.
        """
        if last is None or last.depth is None:
            return ()
        points = sample_points(last.depth, self._camera)
        if not len(points):
            return ()
        T = last.T_world_camera
        points = points @ T[:3, :3].T + T[:3, 3]
        turns = {i: _turn(w, view, points) for i, w in enumerate(self._kept) if self._shared(w, points) > _LEAST_SHARED}
        ordered = sorted(turns, key=turns.__getitem__)
        spread = np.linspace(0, len(ordered) - 1, min(_CALLED, len(ordered))).round().astype(int)
        return tuple(self._kept[ordered[i]] for i in spread)

    def _shared(self, witness: Witness, points: np.ndarray) -> float:
        """Share of points N×3 in the world that are in the witness's picture."""
        camera, T = self._camera, witness.T_world_camera
        local = (points - T[:3, 3]) @ T[:3, :3]
        z = np.where(local[:, 2] > 0, local[:, 2], np.nan)
        u, v = camera.fx * local[:, 0] / z + camera.cx, camera.fy * local[:, 1] / z + camera.cy
        return float(np.mean((u >= 0) & (v >= 0) & (u <= camera.width - 1) & (v <= camera.height - 1)))


def _apart(witnesses: Sequence[Witness]) -> np.ndarray:
    """How different views are: the angle between each two, and their distance as a share of the first one's depth,
    together; N×N, inf of each from itself.
    """
    depths = [w.nearest[::_EVERY, ::_EVERY] for w in witnesses]
    medians = np.array([np.median(known) if (known := z[np.isfinite(z)]).size else 1.0 for z in depths])
    centres = np.array([w.T_world_camera[:3, 3] for w in witnesses])
    axes = np.array([w.T_world_camera[:3, 2] for w in witnesses])
    distance = np.linalg.norm(centres[:, None] - centres[None], axis=2) / medians[:, None]
    apart = distance + np.arccos(np.clip(axes @ axes.T, -1.0, 1.0))
    np.fill_diagonal(apart, np.inf)
    return apart


def _turn(witness: Witness, view: View, points: np.ndarray) -> float:
    """Median angle under which the points see the two cameras, in radians."""
    a, b = (pose[:3, 3] - points for pose in (witness.T_world_camera, view.T_world_camera))
    cosine = np.einsum("nc,nc->n", a, b) / (np.linalg.norm(a, axis=1) * np.linalg.norm(b, axis=1) + 1e-12)
    return float(np.arccos(np.clip(np.median(cosine), -1.0, 1.0)))
