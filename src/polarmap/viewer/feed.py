"""Between a run and what shows it: a thread of its own, which the run never waits for."""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Callable
from functools import partial
from threading import Condition, Thread
from typing import Protocol

import numpy as np

from polarmap.data.keyframe import Keyframe
from polarmap.data.map import Map
from polarmap.geometry.sim3 import Sim3
from polarmap.io.run_folder.results import PictureRanges
from polarmap.niceness import give_way
from polarmap.report.keyframe_pictures import picture_ranges
from polarmap.viewer.patch import Patch, patch_of
from polarmap.viewer.watcher import Tracking

log = logging.getLogger(__name__)

_MOST_WAITING = 8  # keyframes; of more the oldest are not shown
_MOST_POSITIONS = 4096  # of frames that wait to be drawn
_PAUSE = 0.1  # seconds between two looks at what is new


class Display(Protocol):
    """What shows a map; its methods are called by one thread."""

    def track(self, tracking: Tracking, positions: list[np.ndarray]) -> None:
        """The last frame that was followed, and where the camera has been since the one before it."""

    def add(self, patch: Patch) -> None:
        """A keyframe was mapped."""

    def move(self, index: int, pose: Sim3) -> None:
        """A keyframe is elsewhere."""

    def show_map(self, result: Map) -> None:
        """The map is done."""

    def refresh(self) -> None:
        """Do what those who look have asked for meanwhile."""


class Feed:
    """A `Watcher` that shows what it is told on a `Display`, as soon as that has time.

        with Feed(Page()) as feed:
            run_live(..., watcher=feed)

    Of the frames that came meanwhile the last one is shown, and all their positions. not_shown: keyframes that were
    passed over since too many waited. What goes wrong with the display is logged once, and ends no run.
    """

    def __init__(self, display: Display) -> None:
        self._display = display
        self._news = Condition()
        self._tracking: Tracking | None = None
        self._positions: deque[np.ndarray] = deque(maxlen=_MOST_POSITIONS)
        self._keyframes: deque[Keyframe] = deque()
        self._poses: dict[int, Sim3] = {}
        self._map: Map | None = None
        self._ended = False
        self._ranges: PictureRanges | None = None
        self.not_shown = 0
        self._thread = Thread(target=self._show_all, name="polarmap-view", daemon=True)

    def __enter__(self) -> Feed:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        with self._news:
            self._ended = True
            self._news.notify()
        self._thread.join()

    def frame(self, tracking: Tracking) -> None:
        """See `Watcher`."""
        with self._news:
            self._tracking = tracking
            if tracking.T_world_camera is not None:
                self._positions.append(tracking.T_world_camera[:3, 3].copy())

    def keyframe(self, keyframe: Keyframe) -> None:
        """See `Watcher`."""
        with self._news:
            if len(self._keyframes) == _MOST_WAITING:
                self._keyframes.popleft()
                self.not_shown += 1
            self._keyframes.append(keyframe)

    def pose(self, index: int, pose: Sim3) -> None:
        """See `Watcher`."""
        with self._news:
            if self._thread.is_alive():
                self._poses[index] = pose

    def map(self, result: Map) -> None:
        """See `Watcher`."""
        with self._news:
            self._map = result

    def _show_all(self) -> None:
        give_way()
        ended = False
        while not ended:
            with self._news:
                ended = self._ended or self._news.wait_for(lambda: self._ended, _PAUSE)
                news = self._take()
            try:
                for show in news:
                    show()
                self._display.refresh()
            except Exception as problem:  # the browser's side may fail in ways of its own
                log.warning("the view of the map has failed (%s: %s); the run goes on", type(problem).__name__, problem)
                return

    def _take(self) -> list[Callable[[], None]]:
        """What is to be shown, in order."""
        display = self._display
        news: list[Callable[[], None]] = []
        if self._tracking is not None:
            tracking, positions = self._tracking, list(self._positions)
            news.append(partial(display.track, tracking, positions))
        news += [partial(self._add, keyframe) for keyframe in self._keyframes]
        news += [partial(display.move, index, pose) for index, pose in self._poses.items()]
        if self._map is not None:
            news.append(partial(display.show_map, self._map))
        self._tracking, self._map, self._poses = None, None, {}
        self._positions.clear()
        self._keyframes.clear()
        return news

    def _add(self, keyframe: Keyframe) -> None:
        self._ranges = self._ranges or picture_ranges(keyframe)
        self._display.add(patch_of(keyframe, self._ranges))
