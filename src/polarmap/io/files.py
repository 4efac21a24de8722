"""Bytes and text of files: sizes checked before memory is taken, files written whole or not at all."""

from __future__ import annotations

import os
import re
from contextlib import suppress
from itertools import count
from pathlib import Path

from polarmap.errors import InputError, PolarmapError

MAX_IMAGE_BYTES = 1 << 29
MAX_TEXT_BYTES = 1 << 26
PART_FILE = re.compile(r"\.polarmap-\d+-\d+\.part")
"""Names of files that are not whole yet; one that stays was left by a program that was killed."""

_part_numbers = count()


def read_bytes(path: Path, limit: int = MAX_IMAGE_BYTES) -> bytes:
    """A regular file's content; InputError where it cannot be read or is larger than `limit` bytes."""
    try:
        if not path.is_file():
            raise InputError(f"{path}: {'not a regular file' if path.exists() else 'no such file'}")
        size = path.stat().st_size
        if size > limit:
            raise InputError(f"{path}: {size} bytes, more than the {limit} that such a file may have")
        return path.read_bytes()
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be read ({reason(error)})") from None


def read_text(path: Path, limit: int = MAX_TEXT_BYTES) -> str:
    """A UTF-8 text file's content without a byte order mark; InputError where it is none."""
    try:
        return read_bytes(path, limit).decode("utf-8-sig")
    except UnicodeDecodeError:
        raise InputError(f"{path}: not a text file in UTF-8") from None


def data_lines(path: Path) -> list[tuple[int, str]]:
    """(line number from 1, stripped text) of the lines that are neither empty nor a # comment."""
    lines = enumerate(read_text(path).split("\n"), start=1)
    return [(number, text) for number, line in lines if (text := line.strip()) and not text.startswith("#")]


def write_bytes(path: Path, data: bytes) -> None:
    """Write the whole file, or leave what was there and raise PolarmapError. Devices and pipes are written to.

    Nobody ever sees a part of it under its name, even if the process is killed; see `PART_FILE` for what may stay then.
    """
    part = path.with_name(f".polarmap-{os.getpid()}-{next(_part_numbers)}.part")
    try:
        if path.exists() and not (path.is_file() or path.is_dir()):  # such as /dev/stdout: no file may take its place
            path.write_bytes(data)
            return
        part.write_bytes(data)
        os.replace(part, path)
    except (OSError, ValueError) as error:
        raise PolarmapError(f"{path}: cannot be written ({reason(error)})") from None
    finally:
        with suppress(OSError):  # on a read-only disk; what went wrong is said already
            part.unlink(missing_ok=True)


def remove_parts(folder: Path) -> None:
    """Remove what `write_bytes` left unfinished in a folder when its process was killed. Raises OSError."""
    if folder.is_dir():
        for path in folder.iterdir():
            if PART_FILE.fullmatch(path.name):
                path.unlink(missing_ok=True)


def printable(text: str) -> str:
    """Text that can be written as UTF-8: bytes of a file name that are not are shown as in \\xff."""
    try:
        return text.encode("utf-8", "surrogateescape").decode("utf-8", "backslashreplace")
    except UnicodeEncodeError:  # surrogates that stand for no byte
        return text.encode("utf-8", "backslashreplace").decode()


def reason(error: Exception) -> str:
    """What went wrong, without Python's error number and path."""
    return getattr(error, "strerror", None) or str(error)
