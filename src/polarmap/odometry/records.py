"""What is kept for good: frames by their motion from keyframes, keyframes, and the points that left the window."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from polarmap.data.odometry import SparsePoints
from polarmap.data.trajectory import PosedFrame
from polarmap.geometry.camera import PinholeCamera
from polarmap.geometry.pose import inverse, orthonormalized
from polarmap.odometry.pattern import CENTRE, PATTERN_SIZE
from polarmap.odometry.points import ActivePoints

_MAX_POINTS = 400_000  # kept for the point cloud; beyond, every second one is dropped


@dataclass(eq=False)
class KeyframeRecord:
    """A keyframe; its pose follows every adjustment until it leaves the window."""

    index: int
    segment: int
    T_world_camera: np.ndarray


@dataclass(eq=False)
class FrameRecord:
    """A tracked frame, by its motion from a keyframe, with which it moves."""

    index: int
    timestamp: float
    reference: KeyframeRecord
    T_frame_reference: np.ndarray

    @property
    def T_world_camera(self) -> np.ndarray:
        """Its pose, as the keyframe's pose is now."""
        return self.reference.T_world_camera @ inverse(self.T_frame_reference)

    def posed(self) -> PosedFrame:
        """As a result."""
        reference = self.reference
        T = orthonormalized(self.T_world_camera)
        return PosedFrame(self.index, self.timestamp, reference.segment, T, self.index == reference.index)


class PointArchive:
    """Points that will not change any more, by their keyframe."""

    def __init__(self) -> None:
        self._records: list[KeyframeRecord] = []
        self._rows: list[np.ndarray] = []
        self._count = 0

    def add(self, points: ActivePoints, records: dict[int, KeyframeRecord], noise: float) -> None:
        """Keep points; records: of the keyframes by slot. noise: of a residual, in grey values."""
        for slot, record in records.items():
            rows = _rows(points.select(points.host == slot), noise)
            if len(rows):
                self._records.append(record)
                self._rows.append(rows)
                self._count += len(rows)
        if self._count > _MAX_POINTS:
            self._rows = [rows[::2] for rows in self._rows]
            self._count = sum(map(len, self._rows))

    def joined(self, points: ActivePoints, records: dict[int, KeyframeRecord], noise: float) -> PointArchive:
        """This archive with more points in it."""
        archive = PointArchive()
        archive._records, archive._rows, archive._count = [*self._records], [*self._rows], self._count
        archive.add(points, records, noise)
        return archive

    def points(self, camera: PinholeCamera) -> SparsePoints:
        """All points, where their keyframes' poses are now."""
        counts = [len(rows) for rows in self._rows]
        rows = np.concatenate([np.zeros((0, 5), np.float32), *self._rows])
        pixel, inverse_depth = rows[:, :2], rows[:, 2]
        local = camera.unproject(pixel) / inverse_depth[:, None].astype(np.float64)
        starts = np.cumsum([0, *counts])
        position = np.empty((len(rows), 3))
        for record, begin, end in zip(self._records, starts, starts[1:], strict=False):
            T = record.T_world_camera
            position[begin:end] = local[begin:end] @ T[:3, :3].T + T[:3, 3]
        return SparsePoints(
            position=position,
            inverse_depth=inverse_depth,
            inverse_depth_std=rows[:, 3],
            host=np.repeat(np.array([r.index for r in self._records], np.int64), counts),
            pixel=pixel,
            intensity=rows[:, 4],
            segment=np.repeat(np.array([r.segment for r in self._records], np.int64), counts),
        )


def _rows(points: ActivePoints, noise: float) -> np.ndarray:
    """u, v, inverse depth, its standard deviation, and intensity in [0, 1], float32 N×5.

    The pixels of a pattern err together, so all of them say no more than one of them.
    """
    std = noise * np.sqrt(PATTERN_SIZE) / np.sqrt(np.maximum(points.information, 1e-6))
    values = (points.pixel, points.inverse_depth, std, points.color[:, CENTRE] / 255.0)
    return np.column_stack(values).astype(np.float32)
