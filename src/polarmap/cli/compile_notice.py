"""Says that Numba compiles, which takes minutes."""

from __future__ import annotations

from collections.abc import Callable

from numba.core import event


class CompileNotice(event.Listener):
    """Calls `notice` once when Numba starts to compile, which it does only on the first use on a machine."""

    def __init__(self, notice: Callable[[], None]) -> None:
        self._notice = notice
        self._told = False

    def on_start(self, event: event.Event) -> None:
        if not self._told:
            self._told = True
            self._notice()

    def on_end(self, event: event.Event) -> None:
        """Nothing to say."""

    def __enter__(self) -> CompileNotice:
        event.register("numba:compile", self)
        return self

    def __exit__(self, *exception: object) -> None:
        event.unregister("numba:compile", self)
