"""Points of the window: those in adjustment, and those that wait for it until their depth is known."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from polarmap.odometry.pattern import PATTERN, PATTERN_SIZE


@dataclass(eq=False)
class _Table:
    """Arrays with one row per point."""

    def __len__(self) -> int:
        return len(getattr(self, fields(self)[0].name))

    def select(self, rows: np.ndarray):
        """A table of some rows: a mask or indices."""
        return type(self)(*(np.ascontiguousarray(getattr(self, f.name)[rows]) for f in fields(self)))

    def joined(self, other):
        """This table's rows and then the other's."""
        return type(self)(*(np.concatenate([getattr(self, f.name), getattr(other, f.name)]) for f in fields(self)))


@dataclass(eq=False)
class ActivePoints(_Table):
    """Points whose inverse depth is adjusted, N of them in S keyframe slots.

    host int32 N: slot. pixel float32 N×2: (u, v) in the host. inverse_depth float32 N.
    color float32 N×8: the host's intensity over the pattern. weight float32 N×8: sqrt(c²/(c²+|∇I|²)) there.
    state uint8 N×S: of the residual in each keyframe, see `residuals`. information float32 N: of the inverse depth.
    good int32 N: residuals that were ever good.
    """

    host: np.ndarray
    pixel: np.ndarray
    inverse_depth: np.ndarray
    color: np.ndarray
    weight: np.ndarray
    state: np.ndarray
    information: np.ndarray
    good: np.ndarray

    @staticmethod
    def empty(slots: int) -> ActivePoints:
        """No points."""
        return ActivePoints(
            np.zeros(0, np.int32),
            np.zeros((0, 2), np.float32),
            np.zeros(0, np.float32),
            np.zeros((0, PATTERN_SIZE), np.float32),
            np.zeros((0, PATTERN_SIZE), np.float32),
            np.zeros((0, slots), np.uint8),
            np.zeros(0, np.float32),
            np.zeros(0, np.int32),
        )


@dataclass(eq=False)
class ImmaturePoints(_Table):
    """Points whose inverse depth is searched for frame by frame, N of them (DSO's candidates, section 3.2).

    host, pixel, color, weight: as for ActivePoints. structure float32 N×3: sums of gx², gx gy, gy² over the pattern.
    lowest, highest float32 N: the interval that holds the inverse depth; highest is NaN while it is open.
    quality float32 N: second best over best energy of the last search. length float32 N: pixels of the interval's
    last search. status uint8 N: see `tracing`.
    """

    host: np.ndarray
    pixel: np.ndarray
    color: np.ndarray
    weight: np.ndarray
    structure: np.ndarray
    lowest: np.ndarray
    highest: np.ndarray
    quality: np.ndarray
    length: np.ndarray
    status: np.ndarray

    @staticmethod
    def empty() -> ImmaturePoints:
        """No points."""
        return new_immature(np.zeros((5, 5, 3), np.float32), np.zeros((0, 2), np.int32), 0, 50.0)


def new_immature(level: np.ndarray, pixels: np.ndarray, host: int, gradient_constant: float) -> ImmaturePoints:
    """Immature points at pixels (u, v), int N×2, of a keyframe's level 0; nothing is known of their depth."""
    color, weight, structure = describe(level, pixels, gradient_constant)
    count = len(pixels)
    return ImmaturePoints(
        host=np.full(count, host, np.int32),
        pixel=pixels.astype(np.float32),
        color=color,
        weight=weight,
        structure=structure,
        lowest=np.zeros(count, np.float32),
        highest=np.full(count, np.nan, np.float32),
        quality=np.full(count, 1e4, np.float32),
        length=np.full(count, np.inf, np.float32),
        status=np.zeros(count, np.uint8),
    )


def describe(
    level: np.ndarray, pixels: np.ndarray, gradient_constant: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Intensity and weight over the pattern, float32 N×8 each, and structure, float32 N×3, at whole pixels."""
    du, dv = PATTERN.astype(int).T
    u, v = pixels[:, 0, None] + du, pixels[:, 1, None] + dv
    values = level[v, u]
    gx, gy = values[..., 1], values[..., 2]
    c2 = np.float32(gradient_constant**2)
    weight = np.sqrt(c2 / (c2 + gx * gx + gy * gy))
    structure = np.stack([(gx * gx).sum(1), (gx * gy).sum(1), (gy * gy).sum(1)], axis=1)
    return np.ascontiguousarray(values[..., 0]), weight, structure
