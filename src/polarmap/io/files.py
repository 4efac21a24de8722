"""Bytes and text of files: sizes checked before memory is taken, files written whole or not at all."""

from __future__ import annotations

import codecs
import os
import re
from contextlib import suppress
from pathlib import Path

from polarmap.errors import InputError, PolarmapError

MAX_IMAGE_BYTES = 1 << 29
MAX_TEXT_BYTES = 1 << 26
_LINE_END = re.compile(r"\r\n|\r|\n")


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
    lines = enumerate(_LINE_END.split(read_text(path)), start=1)
    return [(number, text) for number, line in lines if (text := line.strip())]


def write_bytes(path: Path, data: bytes) -> None:
    """Write the whole file, or leave what was there and raise PolarmapError. Devices and pipes are written to."""
    part = path.with_name(f".{path.name}.part")
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


def reason(error: Exception) -> str:
    """What went wrong, without Python's error number and path."""
    return getattr(error, "strerror", None) or str(error)
