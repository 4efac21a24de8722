"""How a run kept up with its camera."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Latency:
    """Milliseconds that something came late: median, the value that 99 % stay below, and the largest, of `count`."""

    count: int
    median: float
    p99: float
    largest: float


@dataclass(frozen=True)
class Moment:
    """A stretch of a live run that ends at `seconds` of it.

    pose, surface: largest milliseconds from a frame to its pose, and from a keyframe to the surface with it; 0 where
    none came. waiting: most keyframes that waited. skipped: keyframes that were not mapped; missed: frames that were
    not taken.
    """

    seconds: float
    pose: float = 0.0
    surface: float = 0.0
    waiting: int = 0
    skipped: int = 0
    missed: int = 0

    def joined(self, later: Moment) -> Moment:
        """This stretch and the next, which may overlap, as one."""
        return Moment(
            max(self.seconds, later.seconds),
            max(self.pose, later.pose),
            max(self.surface, later.surface),
            max(self.waiting, later.waiting),
            self.skipped + later.skipped,
            self.missed + later.missed,
        )


@dataclass(frozen=True)
class LiveFigures:
    """A live run in figures.

    pose: from a frame's exposure to its pose; surface: from a keyframe's exposure to the surface with it; None where
    there were none. missed: frames that came while too many waited, and were not taken. skipped, hurried: keyframes
    that were not mapped, or by cheaper ways, since mapping was behind. untraced: frames whose pose was found, but which
    did not help to find the points of others. after: seconds from the last frame to the whole map. moments: the run
    piece by piece.
    """

    pose: Latency | None
    surface: Latency | None
    missed: int
    skipped: int
    hurried: int
    untraced: int
    after: float
    moments: tuple[Moment, ...]
