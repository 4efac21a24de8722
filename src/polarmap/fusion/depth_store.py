"""Where depth maps are kept that may have to be taken out of the surface again: in memory, or on disk."""

from __future__ import annotations

import io
import tempfile
from pathlib import Path
from typing import Protocol

import numpy as np

from polarmap.data.depth_map import DepthMap
from polarmap.errors import PolarmapError
from polarmap.geometry.camera import PinholeCamera
from polarmap.io.files import write_bytes


class DepthStore(Protocol):
    """Depth maps by the number of their frame."""

    def put(self, frame_id: int, depth_map: DepthMap) -> None:
        """Keep a depth map, in place of an earlier one of this number."""
        ...

    def get(self, frame_id: int) -> DepthMap:
        """A depth map, bit for bit as it was put. Raises KeyError where there is none."""
        ...

    def drop(self, frame_id: int) -> None:
        """Forget one. Raises KeyError where there is none."""
        ...


class MemoryStore:
    """Keeps depth maps in memory: for poses that are final after a few keyframes."""

    def __init__(self) -> None:
        self._kept: dict[int, DepthMap] = {}

    def put(self, frame_id: int, depth_map: DepthMap) -> None:
        """See `DepthStore`."""
        self._kept[frame_id] = depth_map

    def get(self, frame_id: int) -> DepthMap:
        """See `DepthStore`."""
        return self._kept[frame_id]

    def drop(self, frame_id: int) -> None:
        """See `DepthStore`."""
        del self._kept[frame_id]


class DiskStore:
    """Keeps depth maps as files: for poses that may change to the end, as where loops are closed.

    folder: where, one file each; a temporary folder if None, which is gone with the store. Every method raises
    PolarmapError where a file cannot be written or read.
    """

    def __init__(self, folder: Path | None = None) -> None:
        if folder is None:
            self._temporary = tempfile.TemporaryDirectory(prefix="polarmap-depth-")
        self._folder = Path(self._temporary.name if folder is None else folder)
        self._cameras: dict[int, PinholeCamera] = {}

    def put(self, frame_id: int, depth_map: DepthMap) -> None:
        """See `DepthStore`."""
        images = np.stack([depth_map.depth, depth_map.grey, depth_map.confidence]).astype(np.float32, copy=False)
        buffer = io.BytesIO()
        np.save(buffer, images, allow_pickle=False)
        write_bytes(self._path(frame_id), buffer.getbuffer())
        self._cameras[frame_id] = depth_map.camera

    def get(self, frame_id: int) -> DepthMap:
        """See `DepthStore`."""
        camera, path = self._cameras[frame_id], self._path(frame_id)
        try:
            images = np.load(path, allow_pickle=False)
        except (OSError, ValueError) as error:
            raise PolarmapError(f"{path}: a kept depth map cannot be read back ({error})") from None
        depth, grey, confidence = images
        return DepthMap(depth, grey, confidence, camera)

    def drop(self, frame_id: int) -> None:
        """See `DepthStore`."""
        del self._cameras[frame_id]
        self._path(frame_id).unlink(missing_ok=True)

    def _path(self, frame_id: int) -> Path:
        return self._folder / f"{frame_id:06d}.npy"
