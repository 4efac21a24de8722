"""Wall time by step."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from time import perf_counter


class StepClock:
    """Adds up the milliseconds spent in named steps: `with clock("stereo"): ...`."""

    def __init__(self) -> None:
        self.milliseconds: dict[str, float] = {}

    @contextmanager
    def __call__(self, step: str) -> Iterator[None]:
        start = perf_counter()
        try:
            yield
        finally:
            self.milliseconds[step] = self.milliseconds.get(step, 0.0) + 1000 * (perf_counter() - start)

    def add(self, milliseconds: dict[str, float]) -> None:
        """Add another clock's times to this one's."""
        for step, time in milliseconds.items():
            self.milliseconds[step] = self.milliseconds.get(step, 0.0) + time
