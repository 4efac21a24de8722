"""When frames were exposed: the camera's clock, brought to that of this computer."""

from __future__ import annotations

import logging
from time import perf_counter, time_ns

log = logging.getLogger(__name__)

_JUMP = 2_000_000_000  # nanoseconds by which a camera's clock may run ahead of what comes, and still be believed
_SAME_CLOCK = 60_000_000_000  # from this computer's: the camera's is set by PTP or the like, TAI included
_DRIFT = 1e-4  # of two quartz clocks


class CameraClock:
    """Times of frames in nanoseconds since 1970, increasing.

    Steps are those of the camera's clock. Its beginning is put to the arrival of the first frame, unless it is within a
    minute of this computer's time, as one is that is set over the network. Where the camera tells no time, frames have
    that of their arrival. Where its clock jumps, which is said once, times go on by arrival over that step.

    name: the camera's, for messages. jumps: how often its clock jumped.
    """

    def __init__(self, name: str) -> None:
        self._name = name
        self._zero = time_ns() - round(1e9 * perf_counter())
        self._last: int | None = None
        self._last_clock: int | None = None
        self._last_came = 0.0
        self._delay = 0.0
        self._silent = False
        self.jumps = 0

    def time(self, clock: int | None, came: float) -> int:
        """When a frame was exposed that shows this time of the camera's clock (nanoseconds) and came then (seconds)."""
        arrival = self._zero + round(1e9 * came)
        if clock is None:
            self._say_that_none_is_told()
            found = arrival
        elif self._last is None or self._last_clock is None:
            found = clock if abs(clock - arrival) < _SAME_CLOCK else arrival
        else:
            found = self._last + self._step(clock - self._last_clock, came)
        found = found if self._last is None else max(found, self._last + 1)
        self._note(found, clock, came)
        return found

    def when(self, nanoseconds: int) -> float:
        """When a frame of this time was exposed, in seconds of `perf_counter`.

        As if the frame that came fastest had come at once: what all are late by cannot be seen from here.
        """
        return (nanoseconds - self._zero) / 1e9 + self._delay

    def _step(self, step: int, came: float) -> int:
        arrival = round(1e9 * (came - self._last_came))
        if 0 < step < arrival + _JUMP:
            return step
        self.jumps += 1
        if self.jumps == 1:
            log.warning(
                "%s: its clock jumped by %.6g s; times go on by arrival there (is it reset, or being synchronized?)",
                self._name, step / 1e9,
            )  # fmt: skip
        return arrival

    def _note(self, found: int, clock: int | None, came: float) -> None:
        late = came - (found - self._zero) / 1e9
        if self._last is None:
            self._delay = late
        else:
            self._delay = min(late, self._delay + _DRIFT * (found - self._last) / 1e9)
        self._last, self._last_clock, self._last_came = found, clock, came

    def _say_that_none_is_told(self) -> None:
        if not self._silent:
            self._silent = True
            log.warning("%s: tells no times; frames have those of their arrival, which are less even", self._name)
