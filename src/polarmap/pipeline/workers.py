"""The threads of a live run: keyframes are mapped and the surface changed beside the frames that are followed.

    frames ──> odometry ──> [ mapping ] ──> [ fusing ]

Each is a thread of its own that does one thing after the other. Mapping and fusing give way to the frames and to
odometry: a keyframe that is mapped later is late, and a frame that waits is late for all that follow. A kernel's own
threads are shared out: those of the machine but one to mapping, one to fusing and to the frames, since a parallel
kernel that waits for threads which others have stops the camera.
"""

from __future__ import annotations

import os
import sys
from concurrent.futures import ThreadPoolExecutor

import cv2
import numba

from polarmap.jit import bears_threads
from polarmap.niceness import give_way

_SWITCH = 0.0005  # seconds after which a thread gives up Python's lock to another; by default ten times as many


class Workers:
    """Executors for a `Mapper` that follows a camera: `mapping` and `fusing`; None each where threads cannot be.

    with Workers() as workers:
        mapper = Mapper(camera, poses, executor=workers.mapping, fusing=workers.fusing, most_waiting=2)

    Inside the block this thread's kernels run on one thread. `beside` says whether there are other threads at all:
    Numba's `workqueue` layer does not bear several that run parallel kernels.
    """

    def __init__(self) -> None:
        self.beside = bears_threads()
        self.mapping = self.fusing = None
        if self.beside:
            mapping = max(1, (os.cpu_count() or 1) - 1)
            self.mapping = ThreadPoolExecutor(1, "polarmap-mapping", _in_background, (mapping,))
            self.fusing = ThreadPoolExecutor(1, "polarmap-fusing", _in_background, (1,))

    def __enter__(self) -> Workers:
        self._before = sys.getswitchinterval(), numba.get_num_threads(), cv2.getNumThreads()
        if self.beside:
            sys.setswitchinterval(_SWITCH)
            numba.set_num_threads(1)
            cv2.setNumThreads(1)
        return self

    def no_more_frames(self) -> None:
        """Nothing is followed any more: what is left to do may use the whole machine."""
        _, threads, opencv = self._before
        numba.set_num_threads(threads)
        cv2.setNumThreads(opencv)
        for executor in (self.mapping, self.fusing):
            if executor is not None:
                executor.submit(_use_threads, threads)

    def __exit__(self, *_: object) -> None:
        for executor in (self.mapping, self.fusing):
            if executor is not None:
                executor.shutdown(cancel_futures=True)
        switch, threads, opencv = self._before
        sys.setswitchinterval(switch)
        numba.set_num_threads(threads)
        cv2.setNumThreads(opencv)


def _in_background(threads: int) -> None:
    give_way()
    _use_threads(threads)


def _use_threads(count: int) -> None:
    numba.set_num_threads(min(count, numba.config.NUMBA_NUM_THREADS))
