"""Photometric calibration of a camera: its response and its vignette (see `polarmap.sensing.photometric`)."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from polarmap.errors import InputError

_LEAST_ENTRIES = 256
_IDENTITY = np.array([0.0, 1.0], np.float32)


@dataclass(frozen=True, eq=False)
class PhotometricCalibration:
    """Response and vignette of a camera, black level taken off, values as shares of full scale.

    inverse_response: G⁻¹ at equidistant pixel values from 0 to 1, float32 N, N at least 256, strictly increasing
        from 0 to 1; None for a linear camera.
    vignette: V, float32 H×W in [0, 1], 1 where the lens lets most through, 0 where nothing; None for none.
    table: float32, G⁻¹, of two entries for a linear camera. gain: 1/V, 0 where V is 0, float32 H×W; 0×0 without a
        vignette.
    Raises InputError where they are otherwise.
    """

    inverse_response: np.ndarray | None = None
    vignette: np.ndarray | None = None
    table: np.ndarray = field(init=False, repr=False)
    gain: np.ndarray = field(init=False, repr=False)

    def __post_init__(self) -> None:
        if self.inverse_response is not None:
            _check_response(np.asarray(self.inverse_response))
        if self.vignette is not None:
            _check_vignette(np.asarray(self.vignette))
        table = _IDENTITY if self.inverse_response is None else np.array(self.inverse_response, np.float32)
        object.__setattr__(self, "table", table)
        object.__setattr__(self, "gain", _gain(self.vignette))


def _check_response(table: np.ndarray) -> None:
    if table.ndim != 1 or len(table) < _LEAST_ENTRIES:
        raise InputError(f"response: {table.size} values, expected {_LEAST_ENTRIES} or more in one row")
    if not np.isfinite(table).all() or table[0] != 0 or table[-1] != 1:
        raise InputError("response: the values must go from 0 to 1")
    if (np.diff(table.astype(np.float32)) <= 0).any():
        raise InputError("response: the values must increase from each to the next")


def _check_vignette(vignette: np.ndarray) -> None:
    if vignette.ndim != 2 or vignette.size == 0:
        raise InputError("vignette: not an image of one channel")
    if not (vignette.min() >= 0 and 0 < vignette.max() <= 1):
        raise InputError("vignette: the values must be in [0, 1], and not all 0")


def _gain(vignette: np.ndarray | None) -> np.ndarray:
    """1/V, 0 where V is 0, float32 H×W; 0×0 for none."""
    if vignette is None:
        return np.empty((0, 0), np.float32)
    vignette = np.array(vignette, np.float32)
    return np.divide(1, vignette, out=np.zeros_like(vignette), where=vignette > 0)
