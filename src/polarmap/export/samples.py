"""Points chosen out of the keyframes' depth: even over the surface, the surest ones first."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

import numpy as np

from polarmap.errors import InputError
from polarmap.export.source import MapSource
from polarmap.io.run_folder.keyframe_file import KeyframeResult

_CANDIDATES = 6  # for each point that is kept
_FINEST_STEP, _COARSEST_STEP = 0.5, 0.97  # from one edge that is tried to the next: a surface has 1/edge² cubes
_MOST_TRIES = 60
_MOST_CELLS = 1 << 20  # along an axis, so that three numbers make one of 64 bits


@dataclass(frozen=True, eq=False)
class Samples:
    """Points with the keyframe that each came from.

    position: float64 N×3, world, counted from the map's origin. normal: float32 N×3, unit. sigma: float32 N,
    standard deviation along the optical axis, in the map's unit. confidence: float32 N, in [0, 1]. label: uint8 N,
    `Reflection`. grey: uint8 N, of the picture; 128 where that is missing. keyframe: int32 N, its index.
    pixel: int32 N×2, (u, v) there.
    """

    position: np.ndarray
    normal: np.ndarray
    sigma: np.ndarray
    confidence: np.ndarray
    label: np.ndarray
    grey: np.ndarray
    keyframe: np.ndarray
    pixel: np.ndarray

    def __len__(self) -> int:
        return len(self.position)

    def __getitem__(self, chosen: np.ndarray) -> Samples:
        return Samples(*(getattr(self, field.name)[chosen] for field in fields(self)))


def choose_samples(source: MapSource, most: int, min_confidence: float) -> Samples:
    """At most `most` points of a map whose confidence is at least `min_confidence`; far fewer where the map is small.

    Each keyframe gives the surest pixel of every square of its image; of all these the surest in every cube of space
    is kept, the cubes being as small as `most` allows. Raises InputError where there is none.
    """
    source.require_keyframes()
    camera = source.camera
    cell = max(1, math.ceil(math.sqrt(camera.width * camera.height * len(source.files) / (_CANDIDATES * most))))
    parts = [_candidates(source, keyframe, cell, min_confidence) for keyframe in source.keyframes("choosing points")]
    found = Samples(*(np.concatenate([getattr(part, f.name) for part in parts]) for f in fields(Samples)))
    if not len(found):
        raise InputError(f"{source.folder}: no point is as sure as {min_confidence:g}; lower --min-confidence")
    return found[_spread(found.position, found.confidence, most)]


def _candidates(source: MapSource, keyframe: KeyframeResult, cell: int, min_confidence: float) -> Samples:
    v, u = _surest_pixels(np.where(np.isfinite(keyframe.depth), keyframe.confidence, 0.0), cell, min_confidence)
    z = keyframe.depth[v, u].astype(np.float64)
    rays = keyframe.camera.unproject(np.stack([u, v], axis=1).astype(np.float64))
    R, t = keyframe.T_world_camera[:3, :3], keyframe.T_world_camera[:3, 3]
    has_picture = source.picture_path(keyframe.index).is_file()
    return Samples(
        position=(z[:, None] * rays) @ R.T + t,
        normal=(np.nan_to_num(keyframe.normal[v, u]) @ R.T).astype(np.float32),
        sigma=(keyframe.sigma[v, u] * z).astype(np.float32),
        confidence=keyframe.confidence[v, u],
        label=keyframe.label[v, u],
        grey=source.picture(keyframe.index)[v, u] if has_picture else np.full(len(z), 128, np.uint8),
        keyframe=np.full(len(z), keyframe.index, np.int32),
        pixel=np.stack([u, v], axis=1).astype(np.int32),
    )


def _surest_pixels(confidence: np.ndarray, cell: int, least: float) -> tuple[np.ndarray, np.ndarray]:
    """(rows, columns) of the surest pixel in each square of `cell` pixels, where it is at least `least` and above 0."""
    height, width = (-(-size // cell) for size in confidence.shape)
    padded = np.zeros((height * cell, width * cell), confidence.dtype)
    padded[: confidence.shape[0], : confidence.shape[1]] = confidence
    squares = padded.reshape(height, cell, width, cell).swapaxes(1, 2).reshape(height, width, cell * cell)
    best = squares.argmax(axis=-1)
    value = np.take_along_axis(squares, best[..., None], axis=-1)[..., 0]
    row, column = np.nonzero((value >= least) & (value > 0))
    inside = best[row, column]
    return row * cell + inside // cell, column * cell + inside % cell


def _spread(position: np.ndarray, confidence: np.ndarray, most: int) -> np.ndarray:
    """Which points are kept: the surest in every cube of the smallest edge that leaves at most `most`."""
    if len(position) <= most:
        return np.arange(len(position))
    order = np.argsort(-confidence, kind="stable")
    from_low = (position - position.min(axis=0))[order]
    edge = float(from_low.max()) or 1.0
    kept = order[:1]
    for _ in range(_MOST_TRIES):
        cells = np.minimum(from_low / edge, _MOST_CELLS - 1).astype(np.int64)
        first = np.unique(cells @ [_MOST_CELLS**2, _MOST_CELLS, 1], return_index=True)[1]
        if len(first) > most:
            break
        kept = np.sort(order[first])
        edge *= np.clip(math.sqrt(len(first) / most), _FINEST_STEP, _COARSEST_STEP)
    return kept
