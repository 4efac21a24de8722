"""What a process holds in memory."""

from __future__ import annotations

import gc
from pathlib import Path

MEGABYTE = 2**20


def resident() -> int:
    """Memory of this process that is in RAM after garbage collection, bytes."""
    gc.collect()
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith("VmRSS:"):
            return 1024 * int(line.split()[1])
    raise SystemExit("/proc/self/status: no VmRSS; this benchmark needs Linux")
