"""Reads numbers, names and arrays one after the other out of a file's bytes, and never beyond their end."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np

from polarmap.errors import InputError
from polarmap.io.files import read_bytes

MAX_BYTES = 1 << 30
_MAX_NAME = 4096


class ByteReader:
    """A file in little-endian order, read from its begin to its end.

    Every method raises InputError, naming the file and what was to be read, where the file ends before that. Arrays
    are views of the file's bytes, so a count that is too large takes no memory.
    """

    def __init__(self, path: Path, limit: int = MAX_BYTES) -> None:
        self.path = Path(path)
        self._data = read_bytes(self.path, limit)
        self._offset = 0

    @property
    def rest(self) -> int:
        """Bytes that are left."""
        return len(self._data) - self._offset

    def numbers(self, layout: str, what: str) -> tuple:
        """Numbers as `struct` describes them ("II"), without padding."""
        return struct.unpack("<" + layout, self._take(struct.calcsize("<" + layout), what))

    def array(self, dtype: str, count: int, what: str) -> np.ndarray:
        """`count` values of a NumPy type, read-only."""
        kind = np.dtype(dtype).newbyteorder("<")
        return np.frombuffer(self._take(count * kind.itemsize, what), kind)

    def count(self, least_bytes: int, what: str) -> int:
        """A uint64 number of items that take at least `least_bytes` each; InputError if so many cannot follow."""
        (count,) = self.numbers("Q", what)
        if count * least_bytes > self.rest:
            raise InputError(f"{self.path}: claims {count} {what}, more than its {len(self._data)} bytes can hold")
        return count

    def name(self, what: str) -> str:
        """Text that ends with a zero byte."""
        end = self._data.find(b"\0", self._offset, self._offset + _MAX_NAME)
        if end < 0:
            raise InputError(f"{self.path}: truncated or malformed in {what}; write it again")
        return _decoded(self._take(end + 1 - self._offset, what)[:-1])

    def text(self, length: int, what: str) -> str:
        """Text of a known number of bytes."""
        return _decoded(self._take(length, what))

    def until(self, mark: bytes, limit: int, what: str) -> memoryview | bytes:
        """What comes before `mark`, within `limit` bytes; the mark is skipped."""
        end = self._data.find(mark, self._offset, self._offset + limit)
        if end < 0:
            raise InputError(f"{self.path}: malformed in {what}")
        found = self._take(end - self._offset, what)
        self._offset += len(mark)
        return found

    def finish(self) -> None:
        """InputError where something is left."""
        if self.rest:
            raise InputError(f"{self.path}: {self.rest} bytes more than its header says; write it again")

    def _take(self, size: int, what: str) -> memoryview | bytes:
        if size > self.rest:
            raise InputError(f"{self.path}: truncated in {what}: {size} bytes expected, {self.rest} left")
        self._offset += size
        return memoryview(self._data)[self._offset - size : self._offset]


def _decoded(data: memoryview | bytes) -> str:
    return bytes(data).decode("utf-8", errors="replace")
