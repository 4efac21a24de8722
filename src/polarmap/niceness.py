"""Threads that let others go first."""

from __future__ import annotations

import os
import sys
import threading
from contextlib import suppress

_STEPS = 10  # of niceness: a ninth of the weight of a thread that others wait for


def give_way() -> None:
    """From now on let this thread run when those that are in a hurry leave the processor to it.

    Threads that it starts do the same. Only on Linux, where threads have priorities of their own.
    """
    if sys.platform == "linux":
        with suppress(OSError):  # where the system does not allow it, it is a matter of speed alone
            thread = threading.get_native_id()
            os.setpriority(os.PRIO_PROCESS, thread, min(os.getpriority(os.PRIO_PROCESS, thread) + _STEPS, 19))
