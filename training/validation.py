"""How well a network does on rendered scenes that it was not trained on."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import torch

from polarmap.geometry.camera import PinholeCamera
from polarmap.prior.polarization_input import network_input
from training.losses import aligned_error
from training.pool import shards
from training.views import HEIGHT, WIDTH

_EVERY = 2  # of the samples


@torch.no_grad()
def validate(network: torch.nn.Module, pool: Path, size: tuple[int, int]) -> dict[str, float]:
    """Mean relative error of inverse depth after the affine fit, with polarization and without, at an input's size."""
    figures = {"val_polarized": [], "val_grey": []}
    network.eval()
    for shard in shards(pool):
        for sample in shard[::_EVERY]:
            stokes = np.stack([_reduced(s, size) for s in sample["stokes"].astype(np.float32)])
            camera = PinholeCamera(WIDTH, HEIGHT, *map(float, sample["camera"]))
            truth = torch.from_numpy(_truth(sample["depth"], size)[None, None])
            for name, channels in (("val_polarized", stokes[1:]), ("val_grey", (None, None))):
                x = network_input(stokes[0] / 2, *channels, camera.resized(size).normalized())
                error, tolerance = aligned_error(network(torch.from_numpy(x[None]))[0], truth)
                figures[name].append(float((error.abs() / tolerance).clamp(max=1.0).mean()))
    return {name: round(float(np.mean(values)), 4) for name, values in figures.items()}


def _reduced(channel: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    return cv2.resize(channel, size[::-1], interpolation=cv2.INTER_AREA)


def _truth(depth: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Inverse depth at the middles of the outputs' pixels, which are twice the input's."""
    v = ((np.arange(size[0] // 2) + 0.5) * 2 * HEIGHT / size[0]).astype(int)
    u = ((np.arange(size[1] // 2) + 0.5) * 2 * WIDTH / size[1]).astype(int)
    return 1.0 / depth[np.ix_(v, u)].astype(np.float32)
