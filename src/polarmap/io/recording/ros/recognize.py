"""What is a ROS bag, by its name and its first bytes; nothing of it is loaded for that."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path

from polarmap.errors import InputError
from polarmap.io.files import MAX_TEXT_BYTES, open_input, read_text

BAG_SUFFIXES = (".bag", ".mcap", ".db3")
METADATA = "metadata.yaml"

_ANY_SIZE = 1 << 62
_BEGINNINGS = {".bag": b"#ROSBAG V2.0\n", ".mcap": b"\x89MCAP0\r\n", ".db3": b"SQLite format 3\0"}
_KINDS = {".bag": "ROS 1 bag", ".mcap": "MCAP file", ".db3": "SQLite file of ROS 2"}
_KEY = "rosbag2_bagfile_information"


def is_bag(path: Path) -> bool:
    """Whether a path is a bag by its name, or a folder of ROS 2 by what lies in it."""
    if not os.path.isdir(path):
        return path.suffix.lower() in BAG_SUFFIXES
    if os.path.isfile(path / METADATA):
        with suppress(InputError):
            return _KEY in read_text(path / METADATA)
        return False
    return bool(_parts(path)) and not any(map(os.path.isdir, _entries(path)))


def require_bag(path: Path) -> None:
    """Raise InputError where a bag is not what its name says, or a folder of one lacks its metadata.yaml."""
    if os.path.isdir(path):
        _require_metadata(path)
        _require_files(path)
        return
    suffix = path.suffix.lower()
    with open_input(path, _ANY_SIZE) as file:
        found = file.read(len(_BEGINNINGS[suffix]))
    if not found:
        raise InputError(f"{path}: is empty; copy or record it again")
    if found != _BEGINNINGS[suffix]:
        other = next((kind for end, kind in _KINDS.items() if found.startswith(_BEGINNINGS[end][:7])), None)
        hint = f"it is a {other}, which must be named so" if other else "truncated, damaged, or another kind of file"
        raise InputError(f"{path}: not a {_KINDS[suffix]}; {hint}")


def _require_metadata(folder: Path) -> None:
    if os.path.isfile(folder / METADATA):
        with open_input(folder / METADATA, MAX_TEXT_BYTES):
            return
    parts = _parts(folder)
    if len(parts) == 1:
        raise InputError(
            f"{folder}: no {METADATA}; name the file itself, {parts[0]}, or run 'ros2 bag reindex {folder}'"
        )
    raise InputError(f"{folder}: no {METADATA}, which tells the order of its files; run 'ros2 bag reindex {folder}'")


def _require_files(folder: Path) -> None:
    """Raise InputError where one that metadata.yaml may name is a pipe or a device, which could hang."""
    for path in _entries(folder):
        if not os.path.isdir(path):
            with open_input(path, _ANY_SIZE):
                continue


def _parts(folder: Path) -> list[Path]:
    return [path for path in _entries(folder) if path.suffix.lower() in (".mcap", ".db3")]


def _entries(folder: Path) -> list[Path]:
    with suppress(OSError):  # a folder that may not be read is said to lack what it should have
        return sorted(folder.iterdir())
    return []
