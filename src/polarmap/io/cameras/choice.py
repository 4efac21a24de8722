"""Which of the cameras that are there is meant."""

from __future__ import annotations

from polarmap.errors import InputError, quoted


def choose(cameras: list[tuple[str, str]], wanted: str | None, where: str) -> int:
    """The index of the camera meant.

    cameras: (serial number, description) of each. wanted: a serial number, or an index from 0; with None there must be
    one alone. where: what was searched, for messages. Raises InputError with a list of those that are there.
    """
    found = "; ".join(f"{i}: {text} (serial number {serial})" for i, (serial, text) in enumerate(cameras))
    if not cameras:
        raise InputError(
            f"{where}: no camera is found; check cable and power, and that no other program and no firewall holds it"
        )
    serials = [serial for serial, _ in cameras]
    if wanted is None:
        if len(cameras) > 1:
            raise InputError(f"{where}: {len(cameras)} cameras, choose one with --device: {found}")
        return 0
    if serials.count(wanted) == 1:
        return serials.index(wanted)
    if wanted.isdecimal() and int(wanted) < len(cameras):
        return int(wanted)
    raise InputError(f"{where}: no camera {quoted(wanted)}; there is {found}")
