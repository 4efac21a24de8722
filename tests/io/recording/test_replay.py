"""A recording played at its own pace: nobody is waited for, and what is lost is counted."""

from __future__ import annotations

import threading
from dataclasses import dataclass, field
from pathlib import Path
from time import perf_counter, sleep

import numpy as np
import pytest

from polarmap.data.frame import Frame
from polarmap.errors import InputError
from polarmap.io.recording.replay import Replay

GAP = 0.02  # seconds from frame to frame


@dataclass
class Recorded:
    """As much of a sequence as is needed; `broken` is the position of a frame that cannot be read."""

    count: int
    broken: int = -1
    camera_file: object = field(default_factory=object)

    @property
    def timestamps(self) -> np.ndarray:
        return 100.0 + GAP * np.arange(self.count)

    def __len__(self) -> int:
        return self.count

    def __iter__(self):
        for i, time in enumerate(self.timestamps):
            if i == self.broken:
                raise InputError("raw/7.png: it is cut off")
            yield Frame(i, float(time), str(i), Path(f"raw/{i}.png"))


def played_threads() -> set[str]:
    return {t.name for t in threading.enumerate() if t.name in ("polarmap-reader", "polarmap-camera")}


def test_frames_come_in_order_and_never_before_their_time():
    replay = Replay(Recorded(12))
    came = [(frame.index, replay.exposed, perf_counter()) for frame in replay]
    assert [index for index, _, _ in came] == list(range(12)) and replay.missed == 0
    assert all(now >= exposed for _, exposed, now in came)
    np.testing.assert_allclose([exposed - replay.begun for _, exposed, _ in came], GAP * np.arange(12), atol=1e-6)
    assert not played_threads()


def test_what_nobody_takes_is_lost_and_counted():
    replay = Replay(Recorded(20), buffer=3)
    came = []
    for frame in replay:
        if not came:
            sleep(30 * GAP)  # all others come meanwhile
        came.append(frame.index)
    assert came == [0, 1, 2, 3] and replay.missed == 16


def test_a_frame_that_cannot_be_read_is_told_at_its_turn():
    came = []
    with pytest.raises(InputError, match="cut off"):
        for frame in Replay(Recorded(12, broken=7)):
            came.append(frame.index)
    assert came == list(range(7)) and not played_threads()


def test_who_leaves_early_leaves_no_threads():
    for frame in Replay(Recorded(500)):
        if frame.index == 2:
            break
    assert not played_threads()
