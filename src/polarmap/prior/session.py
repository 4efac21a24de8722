"""ONNX Runtime on the CPU: sessions that end in time, in bounded memory, and whose failures are one line."""

from __future__ import annotations

import functools
import logging
import os
import threading
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

import numpy as np

from polarmap.errors import InputError

log = logging.getLogger(__name__)

_USUAL_MEMORY = 8 << 30  # bytes, where the system does not say how much it has
_LONGEST_LINE = 200
_SILENT = 4  # of onnxruntime's levels: what it would log comes as an exception


class Session:
    """An ONNX file ready to run. Raises InputError, naming the file, where it is no ONNX network that can be run.

    threads: that it may use. time_limit: seconds that one run may take. Data in other files is read from the
    network's own folder alone, and a network gets no more than half of the machine's memory.
    """

    def __init__(self, path: Path, threads: int, time_limit: float) -> None:
        import onnxruntime  # slow to import, and needed by those alone who use a network

        onnxruntime.set_default_logger_severity(_SILENT)
        self.path = path
        self._time_limit = time_limit
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = threads
        options.inter_op_num_threads = 1
        options.log_severity_level = _SILENT
        options.add_session_config_entry("session.intra_op.allow_spinning", "0")  # other steps want the cores
        if _limit_memory():
            options.add_session_config_entry("session.use_env_allocators", "1")
        try:
            self._session = onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
        except Exception as error:  # onnxruntime's exceptions have no common base of their own
            raise InputError(f"{path}: is not an ONNX network that can be run ({first_line(error)})") from None

    @property
    def inputs(self) -> list:
        """onnxruntime's NodeArgs, with name, shape and type."""
        return self._session.get_inputs()

    @property
    def output_names(self) -> list[str]:
        """In the file's order."""
        return [node.name for node in self._session.get_outputs()]

    @property
    def metadata(self) -> dict[str, str]:
        """What the file says of itself beside the network."""
        return self._session.get_modelmeta().custom_metadata_map

    def run(self, outputs: Sequence[str], tensors: dict[str, np.ndarray]) -> list:
        """The named outputs; InputError where the network fails or takes longer than the time limit."""
        import onnxruntime

        options, late = onnxruntime.RunOptions(), threading.Event()
        options.log_severity_level = _SILENT

        def give_up() -> None:
            late.set()
            options.terminate = True

        timer = threading.Timer(self._time_limit, give_up)
        timer.daemon = True
        timer.start()
        try:
            return self._session.run(list(outputs), tensors, options)
        except Exception as error:
            raise InputError(self._failure(error, tensors, late.is_set())) from None
        finally:
            timer.cancel()
            timer.join()  # no thread of it is left behind

    def _failure(self, error: Exception, tensors: dict[str, np.ndarray], late: bool) -> str:
        if late:
            return (
                f"{self.path}: did not end within {self._time_limit:g} s for one picture; "
                "use a smaller network, or allow it more with prior.time_limit"
            )
        shapes = ", ".join(f"{list(tensor.shape)}" for tensor in tensors.values())
        return f"{self.path}: fails on an input of {shapes} ({first_line(error)})"


@functools.cache
def _limit_memory() -> bool:
    """Bound what all networks of this process may take together; False where this ONNX Runtime cannot."""
    import onnxruntime

    try:
        arena = onnxruntime.OrtArenaCfg({"max_mem": _half_of_memory()})
        kind = onnxruntime.OrtAllocatorType.ORT_ARENA_ALLOCATOR
        memory = onnxruntime.OrtMemoryInfo("Cpu", kind, 0, onnxruntime.OrtMemType.DEFAULT)
        onnxruntime.create_and_register_allocator(memory, arena)
    except Exception as error:  # such as an allocator that the program around this one registered
        log.debug("the memory of networks is not bounded: %s", first_line(error))
        return False
    return True


def _half_of_memory() -> int:
    with suppress(AttributeError, OSError, ValueError):  # no such thing on Windows
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") // 2
    return _USUAL_MEMORY


def first_line(error: Exception) -> str:
    """What an exception says, at most 200 characters on one line."""
    return (str(error).strip().splitlines() or [type(error).__name__])[0][:_LONGEST_LINE]
