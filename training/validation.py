"""How well a network does on rendered scenes that it was not trained on."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import torch

from polarmap.prior.polarization_input import network_input
from training.losses import aligned_error
from training.pool import shards
from training.views import SAMPLE

_EVERY = 2  # of the samples
_SIZE = SAMPLE["depth"].shape


@torch.no_grad()
def validate(network: torch.nn.Module, pool: Path, size: tuple[int, int]) -> dict[str, float]:
    """Mean relative error of inverse depth after the affine fit, with polarization and without, at an input's size."""
    figures = {"val_polarized": [], "val_grey": []}
    network.eval()
    for shard in shards(pool):
        for sample in shard[::_EVERY]:
            stokes = np.stack([_reduced(s, size) for s in sample["stokes"].astype(np.float32)])
            truth = torch.from_numpy(_truth(sample["depth"], size)[None, None])
            for name, channels in (("val_polarized", stokes[1:]), ("val_grey", (None, None))):
                x = network_input(stokes[0] / 2, *channels, _normalized(sample["camera"], size))
                error, tolerance = aligned_error(network(torch.from_numpy(x[None]))[0], truth)
                figures[name].append(float((error.abs() / tolerance).clamp(max=1.0).mean()))
    return {name: round(float(np.mean(values)), 4) for name, values in figures.items()}


def _reduced(channel: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    return cv2.resize(channel, size[::-1], interpolation=cv2.INTER_AREA)


def _truth(depth: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Inverse depth at the middles of the outputs' pixels, which are twice the input's."""
    v = ((np.arange(size[0] // 2) + 0.5) * 2 * _SIZE[0] / size[0]).astype(int)
    u = ((np.arange(size[1] // 2) + 0.5) * 2 * _SIZE[1] / size[1]).astype(int)
    return 1.0 / depth[np.ix_(v, u)].astype(np.float32)


def _normalized(camera: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    (fx, fy, cx, cy), (height, width) = camera, size
    x = ((np.arange(width) + 0.5) * _SIZE[1] / width - 0.5 - cx) / fx
    y = ((np.arange(height) + 0.5) * _SIZE[0] / height - 0.5 - cy) / fy
    return np.stack(np.meshgrid(x, y), axis=-1).astype(np.float32)
