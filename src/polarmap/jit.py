"""How kernels are compiled: Numba's `njit` with a cache that may be missing, and code that is the same cold and warm.

A function that another one calls leaves a copy of itself in the caller's object code, and so does the body of a
parallel loop. The linker takes the copy that was loaded first: in the process that compiles, one that was optimized
once; in later ones, which load object code from the cache, the caller's, optimized twice. Under fast math they differ
in the last bits. So here every kernel keeps its copies to itself and runs the code that goes into the cache.

Kernels run without Python's global lock, so that other threads go on meanwhile: one that maps does not hold up one that
tracks. What that asks of callers:

- A kernel reads and writes the arrays that it is given, and no others that outlive the call. Two threads may be in the
  same kernel at once if neither writes what the other reads or writes; nothing but the caller keeps them apart.
- Parallel kernels share the threads of Numba's threading layer, one of three (`numba.threading_layer()`
  says which). `tbb` and `omp` may be entered by several Python threads at once. `workqueue`, which Numba
  takes where neither of the others can be loaded, may not: it ends the whole process ("Concurrent access has been
  detected"). So a program that calls parallel kernels from more than one thread must keep them apart itself on that
  layer, or have NUMBA_THREADING_LAYER=threadsafe set, with which Numba refuses to start instead. The package's own
  second threads, which write a run's files and adjust odometry's keyframes, call no parallel kernel; all of odometry
  does without.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from functools import cache
from hashlib import sha256
from uuid import uuid4

import numba
import numpy as np
from llvmlite.binding import Linkage
from numba.core.caching import FunctionCache, IndexDataCacheFile, NullCache
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler

log = logging.getLogger(__name__)

FAST_MATH = frozenset({"contract", "arcp", "reassoc", "nsz", "afn"})
"""Sums may be reordered and operations fused; infinities and NaN keep their meaning."""

FINITE_MATH = FAST_MATH | {"nnan", "ninf"}
"""As FAST_MATH, where nothing is ever infinite or NaN."""

_OWN_STAMP = sha256(__loader__.get_data(__file__)).hexdigest()
"""Of this module, as it compiles."""

_SHARED = {Linkage.linkonce_any, Linkage.linkonce_odr, Linkage.weak_any, Linkage.weak_odr}


def njit(function: Callable | None = None, *, fastmath: frozenset[str] = frozenset(), **options):
    """`numba.njit` with a cache and without Python's global lock, as a decorator with or without options.

    fastmath: LLVM's flags, such as FAST_MATH.
    """
    if function is None:
        return lambda decorated: njit(decorated, fastmath=fastmath, **options)
    options = {"nogil": True, "fastmath": set(fastmath), "pipeline_class": _KernelCompiler, **options}
    dispatcher = numba.njit(**options)(function)
    if dispatcher is not function:  # as it is under NUMBA_DISABLE_JIT
        dispatcher._cache = _cache(function)
    return dispatcher


class _OwnCode(JITCodeLibrary):
    """Object code that uses its own copies of what was linked into it, whatever else the process has loaded."""

    def _optimize_final_module(self) -> None:
        super()._optimize_final_module()
        for function in self._final_module.functions:
            if not function.is_declaration and function.linkage in _SHARED:
                function.linkage = Linkage.internal


class _KernelCompiler(Compiler):
    """Numba's compiler, into `_OwnCode`."""

    def define_pipelines(self):
        if self.state.library is None:
            self.state.library = _OwnCode(self.state.targetctx.codegen(), self.state.func_id.func_qualname)
            self.state.library.enable_object_caching()
        return super().define_pipelines()


class _OwnFiles(IndexDataCacheFile):
    """The files of a function's cache, one for each signature, whose names no other process takes.

    Numba counts them. Of two processes that compile at once, each may then put its code under the name that the other
    one's index gives to another signature, and code for other types is run in silence.
    """

    def _data_name(self, number: int) -> str:
        return super()._data_name(uuid4().int)

    def _load_index(self) -> dict:
        """Nothing where it cannot be understood: it is damaged, or names types that an earlier version had."""
        try:
            return super()._load_index()
        except OSError:
            raise
        except Exception:
            return {}


class KernelCache(FunctionCache):
    """Numba's cache on disk. What cannot be read from it is compiled; what cannot be written is said once.

    Code is taken from it as long as neither the kernel's file nor this module, which says how to compile, has changed.
    """

    def __init__(self, function: Callable) -> None:
        super().__init__(function)
        self._cache_file = _OwnFiles(
            cache_path=self._cache_path,
            filename_base=self._impl.filename_base,
            source_stamp=(self._impl.locator.get_source_stamp(), _OWN_STAMP),
        )

    def load_overload(self, sig, target_context):
        try:
            return super().load_overload(sig, target_context)
        except Exception:  # of whatever kind a damaged file gives
            return None

    def save_overload(self, sig, data) -> None:
        try:
            super().save_overload(sig, data)
        except OSError as problem:
            _say_once(f"{problem.filename or self.cache_path}: {problem.strerror}")


class _NoCache(NullCache):
    """In place of a cache, where no folder for one may be written."""

    def save_overload(self, sig, data) -> None:
        _say_once("neither the package's folder nor the user's cache folder may be written")


def _cache(function: Callable) -> KernelCache | _NoCache:
    try:
        return KernelCache(function)
    except (RuntimeError, OSError):  # Numba's "no locator available"
        return _NoCache()


@cache
def _say_once(reason: str) -> None:
    log.warning(
        "compiled code cannot be kept, so that every run compiles anew for some minutes (%s); "
        "set NUMBA_CACHE_DIR to a folder that may be written and has 50 MB of space",
        reason,
    )


def bears_threads() -> bool:
    """Whether parallel kernels may be run by several Python threads at once: not on Numba's `workqueue` layer.

    Starts the layer's threads, if none has yet.
    """
    _count(np.zeros(1, np.int64))
    return numba.threading_layer() != "workqueue"


@njit(parallel=True)
def _count(counts):
    for i in numba.prange(counts.shape[0]):
        counts[i] += 1
