"""Bytes and text of files: sizes checked before memory is taken, files written whole or not at all."""

from __future__ import annotations

import codecs
import os
import re
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from itertools import count
from pathlib import Path
from typing import BinaryIO

from polarmap.errors import InputError, PolarmapError

MAX_IMAGE_BYTES = 1 << 29
MAX_TEXT_BYTES = 1 << 26
MAX_LINES = 1_000_000  # of a list of times or poses: nine hours at 30 Hz

PART_FILE = re.compile(r"\.polarmap-\d+-\d+\.part")
"""Names of files that are not whole yet; one that stays was left by a program that was killed."""

_CHUNK = 1 << 16
_LINE_END = re.compile(r"\r\n|\r|\n")
_part_numbers = count()


@contextmanager
def open_input(path: Path, limit: int) -> Iterator[BinaryIO]:
    """A regular file, open for reading, that has at most `limit` bytes; every reader of the package opens files so.

    Raises InputError where there is no such file or it is a folder, pipe, socket or device (which could hang or never
    end), is larger, or cannot be opened. An OSError inside the block becomes an InputError too.
    """
    try:
        _require_regular(path, os.stat(path))  # before it is opened: to open a device may already do something
        with open(path, "rb", opener=_without_waiting) as file:
            status = os.fstat(file.fileno())
            _require_regular(path, status)
            if status.st_size > limit:
                raise InputError(f"{path}: {status.st_size} bytes, more than the {limit} that such a file may have")
            yield file
    except FileNotFoundError:
        raise InputError(f"{path}: no such file") from None
    except (OSError, ValueError) as error:  # ValueError: a name with a zero byte
        raise InputError(f"{path}: cannot be read ({reason(error)})") from None


def read_bytes(path: Path, limit: int = MAX_IMAGE_BYTES) -> bytes:
    """A regular file's content; InputError where it cannot be read or is larger than `limit` bytes."""
    with open_input(path, limit) as file:
        size = os.fstat(file.fileno()).st_size
        data = file.read(size + 1)
        while data and size < len(data) <= limit and (more := file.read(_CHUNK)):  # one that grows, or is of /proc
            data += more
    if data is None or len(data) > limit:
        raise InputError(f"{path}: more than the {limit} bytes that such a file may have")
    return data


def read_text(path: Path, limit: int = MAX_TEXT_BYTES) -> str:
    """A text file's content, UTF-8 or UTF-16 with a byte order mark, without that mark; InputError where it is none."""
    data = read_bytes(path, limit)
    wide = data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
    try:
        return data.decode("utf-16" if wide else "utf-8-sig")
    except UnicodeDecodeError:
        raise InputError(f"{path}: not a text file in UTF-8") from None


def data_lines(path: Path) -> list[tuple[int, str]]:
    """(line number from 1, stripped text) of the lines that are neither empty nor a # comment."""
    return [(number, text) for number, text in text_lines(path) if not text.startswith("#")]


def text_lines(path: Path) -> list[tuple[int, str]]:
    """(line number from 1, stripped text) of the lines that are not empty, whatever ends them (Unix, Windows, Mac)."""
    text = read_text(path)
    if (ends := max(text.count("\n"), text.count("\r"))) > MAX_LINES:
        raise InputError(f"{path}: {ends} lines, more than the {MAX_LINES} that such a file may have")
    lines = enumerate(_LINE_END.split(text), start=1)
    return [(number, text) for number, line in lines if (text := line.strip())]


def write_bytes(path: Path, data: bytes | memoryview) -> None:
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


def _require_regular(path: Path, status: os.stat_result) -> None:
    if stat.S_ISDIR(status.st_mode):
        raise InputError(f"{path}: a folder, where a file is expected")
    if not stat.S_ISREG(status.st_mode):
        raise InputError(f"{path}: not a regular file but a pipe, socket or device; copy its content to a file")


def _without_waiting(path: str, flags: int) -> int:
    """Opens at once what takes a regular file's place after it was looked at: a pipe would wait for its writer."""
    return os.open(path, flags | getattr(os, "O_NONBLOCK", 0))
