"""Requests to stop (SIGINT, SIGTERM, SIGHUP) that wait until the work can be left in order."""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Callable
from types import FrameType, TracebackType
from typing import Any

SIGNALS = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))
_PATIENCE = 3  # the so manieth request quits at once
_received: list[int] = []  # signals belong to the process, and so does what came of them


class Stopped(KeyboardInterrupt):
    """A signal asked the program to stop. number: of the signal."""

    def __init__(self, number: int) -> None:
        super().__init__(f"stopped by {signal.Signals(number).name}")
        self.number = number


class StopRequests:
    """While it is entered, signals that ask to stop are noted, and raised where the work says so.

        with StopRequests() as stop:
            for frame in sequence:
                stop.check()  # raises Stopped
                ...

    After the first request the work may still be brought to its end, undisturbed by a second one; the third ends the
    process at once. What was noted and not yet raised when the block is left without another exception is raised then.
    Signals come to the main thread alone: in another one, and where the signal is ignored as under nohup, nothing is
    changed. `on_request` is called at each request, as a signal handler is: it must only do what such a one may.
    """

    def __init__(self, on_request: Callable[[int], None] | None = None) -> None:
        self._on_request = on_request
        self._before: dict[int, Any] = {}
        self._requests: list[int] = []
        self._raised = False

    @property
    def requested(self) -> bool:
        """Whether a signal has asked to stop."""
        return bool(self._requests)

    def check(self) -> None:
        """Raise Stopped if a signal has asked to stop, once."""
        if self._requests and not self._raised:
            self._raised = True
            raise Stopped(self._requests[0])

    def __enter__(self) -> StopRequests:
        if threading.current_thread() is threading.main_thread():
            for number in SIGNALS:
                before = signal.getsignal(number)
                if before not in (None, signal.SIG_IGN):
                    self._before[number] = before
                    signal.signal(number, self._note)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        for number, before in self._before.items():
            signal.signal(number, before)
        self._before.clear()
        if error is None:
            self.check()

    def _note(self, number: int, frame: FrameType | None) -> None:
        self._requests.append(number)
        _received.append(number)
        if len(self._requests) >= _PATIENCE:
            signal.signal(number, signal.SIG_DFL)
            os.kill(os.getpid(), number)
        if self._on_request is not None:
            self._on_request(len(self._requests))


class EndRequests(StopRequests):
    """Requests to stop that are how the work is meant to end, as that with a camera: they are noted, and never raised.

    Whoever gives the work its input asks `requested`, and gives no more.
    """

    def check(self) -> None:
        """Raise nothing."""


def raise_stopped() -> None:
    """Have every signal that asks to stop raise Stopped in the main thread from now on, as Ctrl-C does by itself."""

    def stop(number: int, frame: FrameType | None) -> None:
        _received.append(number)
        raise Stopped(number)

    _received.clear()
    for number in SIGNALS:
        if signal.getsignal(number) not in (None, signal.SIG_IGN):
            signal.signal(number, stop)


def was_stopped() -> bool:
    """Whether a signal has asked to stop since the process began."""
    return bool(_received)


def stopped_status() -> int:
    """The exit status after a stop: 128 + the first signal's number."""
    return 128 + (_received[0] if _received else signal.SIGINT)


def say_at_once(text: str) -> None:
    """Write a line to stderr from a signal handler, where Python's own streams may be in use."""
    try:
        os.write(sys.__stderr__.fileno(), text.encode("ascii", "replace") + b"\n")
    except (OSError, ValueError, AttributeError):  # closed, or none at all
        return
