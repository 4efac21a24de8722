"""Threads that let others go first."""

from __future__ import annotations

import os
import sys
import threading
from contextlib import suppress

BACKGROUND = 10  # steps of niceness: a ninth of the weight of a thread that others wait for
SOON = 5  # a third of it


def give_way(steps: int = BACKGROUND) -> None:
    """From now on let this thread run when those that are in a hurry leave the processor to it.

    Threads that it starts do the same. Only on Linux, where threads have priorities of their own.
    """
    if sys.platform == "linux":
        with suppress(OSError):  # where the system does not allow it, it is a matter of speed alone
            thread = threading.get_native_id()
            os.setpriority(os.PRIO_PROCESS, thread, min(os.getpriority(os.PRIO_PROCESS, thread) + steps, 19))
