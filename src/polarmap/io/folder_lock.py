"""A lock on an output folder: one program writes into it at a time."""

from __future__ import annotations

import errno
import logging
import os
import weakref
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import TracebackType

from polarmap.errors import InputError
from polarmap.io.files import reason

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None

log = logging.getLogger(__name__)

LOCK_NAME = ".polarmap.lock"
_FLAGS = os.O_RDWR | os.O_CREAT | getattr(os, "O_CLOEXEC", 0) | getattr(os, "O_NOFOLLOW", 0)
_TAKEN = (errno.EAGAIN, errno.EACCES)


class FolderLock:
    """Locks a folder that exists, from `acquire` to `release` or as a context.

    The lock belongs to the process: the system frees it however that ends, kill -9 included. It is kept on a file in
    the folder, which holds the process's number and is removed in the end. Where the file system knows no locks, as
    some network ones, or the file cannot be made, the work goes on without one.
    """

    def __init__(self, folder: Path) -> None:
        self.path = Path(folder) / LOCK_NAME
        self._file: int | None = None
        self._close: weakref.finalize | None = None

    def acquire(self) -> FolderLock:
        """Raise InputError where another process, or this one, has the lock."""
        while fcntl is not None and self._file is None:
            try:
                file = os.open(self.path, _FLAGS, 0o644)
            except OSError as error:
                log.debug("%s: no lock (%s)", self.path, reason(error))
                return self
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError as error:
                holder = _text(file)
                os.close(file)
                if error.errno not in _TAKEN:
                    log.warning("%s: no lock (%s); make sure that nothing else writes there", self.path, reason(error))
                    return self
                raise InputError(
                    f"{self.path.parent}: is being written by another run (process {holder or 'unknown'}); "
                    "wait for its end or choose another folder"
                ) from None
            if self._is_still(file):
                self._file, self._close = file, weakref.finalize(self, _close, file)
                with suppress(OSError):  # a full disk: the lock holds all the same
                    os.ftruncate(file, 0)
                    os.write(file, f"{os.getpid()}\n".encode())
            else:  # its holder removed it just now
                os.close(file)
        return self

    def release(self) -> None:
        """Give the folder back; nothing where it was not locked."""
        if self._file is not None:
            with suppress(OSError):
                if self._is_still(self._file):
                    self.path.unlink()
            self._close()
            self._file = None

    @contextmanager
    def on_error(self) -> Iterator[None]:
        """Acquire, and release where the block raises; raises InputError as `acquire` does."""
        self.acquire()
        try:
            yield
        except BaseException:
            self.release()
            raise

    def __enter__(self) -> FolderLock:
        return self.acquire()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.release()

    def _is_still(self, file: int) -> bool:
        """Whether the open file is the one that stands in the folder."""
        try:
            return os.path.samestat(os.fstat(file), os.stat(self.path))
        except OSError:
            return False


def _close(file: int) -> None:
    with suppress(OSError):
        os.close(file)


def _text(file: int) -> str:
    with suppress(OSError, ValueError):
        return str(int(os.pread(file, 32, 0)))
    return ""
