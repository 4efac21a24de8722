"""A whole run: a sequence mapped into an output folder."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress

from numba.core import event

from polarmap.config import Config
from polarmap.errors import PolarmapError
from polarmap.io.sequence import Sequence
from polarmap.io.trajectory import Trajectory
from polarmap.mapper import Mapper
from polarmap.prior import Prior
from polarmap.report.run_writer import RunWriter
from polarmap.results import Map


def run_sequence(
    sequence: Sequence,
    poses: Trajectory,
    writer: RunWriter,
    prior: Prior | None = None,
    config: Config | None = None,
    on_frame: Callable[[int], None] | None = None,
) -> Map:
    """Map `sequence` with given poses and write all that comes out through `writer`, keyframe by keyframe.

    on_frame: called after each frame with the number of keyframes so far. If this fails or is interrupted, the
    keyframes and the map until then are written first. Raises InputError for bad frames or poses, PolarmapError if
    the output cannot be written.
    """
    poses.require_overlap(sequence.timestamps)
    mapper = Mapper(sequence.camera_file, poses.at, prior, config, on_keyframe=writer.add_keyframe)
    with writer:
        try:
            for frame in sequence:
                mapper.process(frame)
                writer.add_frame(frame.timestamp, poses.at(frame.timestamp))
                if on_frame:
                    on_frame(mapper.keyframe_count)
        except (PolarmapError, KeyboardInterrupt):
            with suppress(PolarmapError):
                writer.add_map(mapper.finish())
            raise
        result = mapper.finish()
        writer.add_map(result)
    return result


class CompileNotice(event.Listener):
    """Calls `notice` once when Numba starts to compile, which it does only on the first use on a machine."""

    def __init__(self, notice: Callable[[], None]) -> None:
        self._notice = notice
        self._told = False

    def on_start(self, event: event.Event) -> None:
        if not self._told:
            self._told = True
            self._notice()

    def on_end(self, event: event.Event) -> None:
        """Nothing to say."""

    def __enter__(self) -> CompileNotice:
        event.register("numba:compile", self)
        return self

    def __exit__(self, *exception: object) -> None:
        event.unregister("numba:compile", self)
