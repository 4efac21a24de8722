"""How kernels are compiled: Numba's `njit` with a cache that may be missing, and code that is the same cold and warm.

A function that another one calls leaves a copy of itself in the caller's object code, and so does the body of a
parallel loop. The linker takes the copy that was loaded first: in the process that compiles, one that was optimized
once; in later ones, which load object code from the cache, the caller's, optimized twice. Under fast math they differ
in the last bits. So here every kernel keeps its copies to itself and runs the code that goes into the cache.
"""

from __future__ import annotations

import logging
from collections.abc import Callable

import numba
from llvmlite.binding import Linkage
from numba.core.caching import FunctionCache
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler

log = logging.getLogger(__name__)

FAST_MATH = frozenset({"contract", "arcp", "reassoc", "nsz", "afn"})
"""Sums may be reordered and operations fused; infinities and NaN keep their meaning."""

FINITE_MATH = FAST_MATH | {"nnan", "ninf"}
"""As FAST_MATH, where nothing is ever infinite or NaN."""

_SHARED = {Linkage.linkonce_any, Linkage.linkonce_odr, Linkage.weak_any, Linkage.weak_odr}


def njit(function: Callable | None = None, *, fastmath: frozenset[str] = frozenset(), **options):
    """`numba.njit` with a cache, as a decorator with or without options.

    fastmath: LLVM's flags, such as FAST_MATH.
    """
    if function is None:
        return lambda decorated: njit(decorated, fastmath=fastmath, **options)
    dispatcher = numba.njit(fastmath=set(fastmath), pipeline_class=_KernelCompiler, **options)(function)
    if dispatcher is not function:  # as it is under NUMBA_DISABLE_JIT
        _use_cache(dispatcher)
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


class KernelCache(FunctionCache):
    """Numba's cache on disk. Where it cannot be read or written, the function is compiled, and one line says why."""

    def load_overload(self, sig, target_context):
        try:
            return super().load_overload(sig, target_context)
        except (OSError, EOFError, ValueError) as problem:
            _compile_each_time(problem)
            return None

    def save_overload(self, sig, data) -> None:
        try:
            super().save_overload(sig, data)
        except OSError as problem:
            _compile_each_time(problem)


def _use_cache(dispatcher) -> None:
    try:
        dispatcher._cache = KernelCache(dispatcher.py_func)
    except (RuntimeError, OSError) as problem:  # no folder that may be written
        _compile_each_time(problem)


_told = False


def _compile_each_time(problem: Exception) -> None:
    global _told
    if _told:
        return
    _told = True
    reason = f"{problem.filename}: {problem.strerror}" if isinstance(problem, OSError) else "no folder may be written"
    log.warning(
        "compiled code cannot be kept (%s), so every run compiles anew for some minutes; "
        "set NUMBA_CACHE_DIR to a folder with 200 MB of space that may be written",
        reason,
    )
