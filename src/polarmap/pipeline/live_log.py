"""Takes down how a live run keeps up, in memory that does not grow with its length."""

from __future__ import annotations

import numpy as np

from polarmap.data.live import Latency, LiveFigures, Moment

_BIN = 0.5  # milliseconds
_BINS = 120_000  # a minute; what takes longer is counted as that
_MOST_MOMENTS = 600  # then every two become one


class LatencyCount:
    """Counts latencies in milliseconds, in bins of half of one."""

    def __init__(self) -> None:
        self._counts = np.zeros(_BINS, np.int64)
        self._largest = 0.0

    def add(self, milliseconds: float) -> None:
        """Count one."""
        self._counts[min(int(max(milliseconds, 0.0) / _BIN), _BINS - 1)] += 1
        self._largest = max(self._largest, milliseconds)

    def latency(self) -> Latency | None:
        """Of those counted until now; None where there are none. Quantiles are exact to a bin."""
        count = int(self._counts.sum())
        if count == 0:
            return None
        below = np.cumsum(self._counts)
        median, p99 = (
            min((float(np.searchsorted(below, share * count)) + 0.5) * _BIN, self._largest) for share in (0.5, 0.99)
        )
        return Latency(count, median, p99, self._largest)


class LiveLog:
    """Of a run whose frames come at their times. All times are in seconds from when it began."""

    def __init__(self) -> None:
        self._poses, self._surfaces = LatencyCount(), LatencyCount()
        self._moments: list[Moment] = []
        self._length = 1.0  # seconds of a moment
        self._missed = self._skipped = 0
        self._last = 0.0

    def frame(self, exposed: float, done: float, waiting: int, missed: int, skipped: int) -> None:
        """A frame has its pose.

        exposed, done: when it was exposed and when its pose was known. waiting: keyframes that wait. missed, skipped:
        frames that were not taken and keyframes that were not mapped, until now.
        """
        late = 1000 * (done - exposed)
        self._poses.add(late)
        self._last = max(self._last, exposed)
        new = Moment(done, late, 0.0, waiting, skipped - self._skipped, missed - self._missed)
        self._missed, self._skipped = missed, skipped
        self._note(new)

    def surface(self, exposed: float, done: float) -> None:
        """A keyframe that was exposed then has become part of the surface."""
        late = 1000 * (done - exposed)
        self._surfaces.add(late)
        self._note(Moment(done, surface=late))

    def figures(self, now: float, hurried: int, untraced: int) -> LiveFigures:
        """All that was taken down, when the map is done."""
        return LiveFigures(
            self._poses.latency(),
            self._surfaces.latency(),
            self._missed,
            self._skipped,
            hurried,
            untraced,
            now - self._last,
            tuple(self._moments),
        )

    def _note(self, new: Moment) -> None:
        if self._moments and new.seconds // self._length <= self._moments[-1].seconds // self._length:
            self._moments[-1] = self._moments[-1].joined(new)
            return
        self._moments.append(new)
        if len(self._moments) > _MOST_MOMENTS:
            pairs = zip(self._moments[::2], [*self._moments[1::2], None], strict=False)
            self._moments = [a if b is None else a.joined(b) for a, b in pairs]
            self._length *= 2
