"""The frames of a recording, read when they are asked for."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import replace
from typing import Generic, TypeVar, overload

Files = TypeVar("Files")
Frame = TypeVar("Frame")
Recording = TypeVar("Recording", bound="RecordedFrames")


class RecordedFrames(ABC, Generic[Files, Frame]):
    """Frames by position, each read when asked for; slices are recordings of the same kind.

    For dataclasses with a field `files`: where the frames are, in their order.
    """

    files: tuple[Files, ...]

    @abstractmethod
    def _read(self, files: Files) -> Frame:
        """The frame that is in these files."""

    def __len__(self) -> int:
        return len(self.files)

    def __iter__(self) -> Iterator[Frame]:
        return (self._read(files) for files in self.files)

    @overload
    def __getitem__(self, position: int) -> Frame: ...
    @overload
    def __getitem__(self: Recording, position: slice) -> Recording: ...
    def __getitem__(self, position):
        if isinstance(position, slice):
            return replace(self, files=self.files[position])
        return self._read(self.files[position])
