"""Where depth jobs are done: here and now, or wherever an executor of `concurrent.futures` does them."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from typing import Protocol, TypeVar

_Job = TypeVar("_Job")
_Result = TypeVar("_Result")


class Executor(Protocol):
    """What the mapper needs of one; `concurrent.futures.ThreadPoolExecutor(1)` is one.

    It is given the next job when the one before is done, so that results come in order. Kernels of jobs run beside
    those of the thread that follows the frames: Numba's threading layer must bear that (see docs/architecture.md).
    """

    def submit(self, work: Callable[[_Job], _Result], job: _Job, /) -> Future[_Result]:
        """Have work(job) done."""
        ...


class InLine:
    """Does each job at once, in the caller's thread."""

    def submit(self, work: Callable[[_Job], _Result], job: _Job, /) -> Future[_Result]:
        """See `Executor`; what the work raises, this raises."""
        done: Future[_Result] = Future()
        done.set_result(work(job))
        return done
