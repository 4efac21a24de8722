"""The .npz archives of keyframes, without pickle: every array is checked before memory is taken for it."""

from __future__ import annotations

import math
import struct
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

import numpy as np

from polarmap.errors import InputError
from polarmap.io.files import open_input, reason
from polarmap.io.formats.images import MAX_PIXELS
from polarmap.io.formats.npy_header import read_npy_header

MAX_NPZ_BYTES = 1 << 30

_MOST_UNPACKED = 1 << 28  # bytes of all members together, where the archive is compressed
_MAX_DIRECTORY = 1 << 16  # bytes, for some hundreds of members
_END = b"PK\5\6"
_END_64 = b"PK\6\7"
_LONGEST_TAIL = 22 + (1 << 16)  # the end's record and the longest comment
_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
_BROKEN = (
    EOFError,
    ValueError,
    NotImplementedError,  # a version or encryption that zipfile does not know
    RuntimeError,
    struct.error,
    zipfile.BadZipFile,
    zlib.error,
)


class NpzReader:
    """The arrays of an open archive. Its methods raise InputError, without the file's name."""

    def __init__(self, archive: zipfile.ZipFile) -> None:
        self._archive = archive
        self.members = archive.infolist()
        self.names = frozenset(m.filename[:-4] for m in self.members if m.filename.endswith(".npy"))

    def array(self, name: str, dtype: type, shape: tuple[int | None, ...]) -> np.ndarray:
        """An array of this type and shape (None: any length), not writable; InputError where it is anything else."""
        if name not in self.names:
            raise InputError(f"lacks the array '{name}'")
        kind = np.dtype(dtype)
        with self._archive.open(f"{name}.npy") as member:
            found = _read_header(name, member)
            fits = len(found.shape) == len(shape) and all(map(_fits, found.shape, shape))
            if not fits or found.dtype != kind or found.fortran_order:
                raise InputError(
                    f"'{name}' is {found.dtype} {_described(found.shape)}, expected {kind} {_described(shape)}"
                )
            count = math.prod(found.shape)
            if count > 3 * MAX_PIXELS:
                raise InputError(f"'{name}' claims {count} values, more than an image may have")
            size = count * kind.itemsize
            left = self._archive.getinfo(f"{name}.npy").file_size
            data = member.read(size) if size <= left else b""
            if len(data) != size or member.read(1):
                raise InputError(f"'{name}' does not hold what its header says")
        return np.frombuffer(data, kind).reshape(found.shape)

    def raw(self, member: zipfile.ZipInfo) -> bytes:
        """A member as it is, header and values."""
        return self._archive.read(member)


@contextmanager
def open_npz(path: Path) -> Iterator[NpzReader]:
    """An archive, open for reading.

    Raises InputError, naming the file, where it is none, has a member twice or one that is packed otherwise than by
    deflation, or would unpack to far more than it takes on the disk. So does whatever goes wrong in the block.
    """
    with open_input(path, MAX_NPZ_BYTES) as file:
        try:
            size = _checked_size(file)
            with zipfile.ZipFile(file) as archive:
                _check_members(archive.infolist(), size)
                yield NpzReader(archive)
        except InputError as problem:
            raise InputError(f"{path}: {problem}") from None
        except _BROKEN as error:
            raise InputError(f"{path}: not a readable keyframe file ({reason(error)})") from None


def _checked_size(file: IO[bytes]) -> int:
    """The archive's bytes; InputError where its directory is larger than one of a few arrays."""
    size = file.seek(0, 2)
    file.seek(-min(size, _LONGEST_TAIL), 2)
    tail = file.read(_LONGEST_TAIL)
    end = tail.rfind(_END)
    if end < 0 or len(tail) - end < 22:
        raise InputError("not a readable keyframe file (it has no end; copy the file again)")
    (directory,) = struct.unpack_from("<I", tail, end + 12)
    if directory > _MAX_DIRECTORY or _END_64 in tail[max(end - 20, 0) : end]:
        raise InputError("has a directory larger than one of a few arrays")
    return size


def _check_members(members: list[zipfile.ZipInfo], size: int) -> None:
    if len({member.filename for member in members}) < len(members):
        raise InputError("has an array twice")
    packed = next((member for member in members if member.compress_type not in _METHODS), None)
    if packed is not None:
        raise InputError(f"'{packed.filename}' is packed by a method that is not read; write it with numpy.savez")
    if (unpacked := sum(member.file_size for member in members)) > max(size, _MOST_UNPACKED):
        raise InputError(f"has {size} bytes that unpack to {unpacked}; write it with numpy.savez, not compressed")


def _read_header(name: str, member: IO[bytes]):
    try:
        return read_npy_header(member)
    except InputError as problem:
        raise InputError(f"'{name}': {problem}") from None


def _fits(side: int, expected: int | None) -> bool:
    return expected in (None, side)


def _described(shape: tuple[int | None, ...]) -> str:
    return "x".join("N" if n is None else str(n) for n in shape) or "scalar"
