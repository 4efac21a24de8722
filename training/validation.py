"""How well a network does on rendered scenes that it was not trained on."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch

from polarmap.prior.polarization_input import network_input
from training.losses import aligned_error
from training.pool import shards
from training.views import SAMPLE

_EVERY = 2  # of the samples
_SIZE = SAMPLE["depth"].shape


@torch.no_grad()
def validate(network: torch.nn.Module, pool: Path) -> dict[str, float]:
    """Mean relative error of inverse depth after the affine fit, with polarization and without."""
    figures = {"val_polarized": [], "val_grey": []}
    network.eval()
    for shard in shards(pool):
        for sample in shard[::_EVERY]:
            stokes = sample["stokes"].astype(np.float32)
            truth = torch.from_numpy(1.0 / sample["depth"].astype(np.float32)[None, None, 1::2, 1::2])
            for name, channels in (("val_polarized", stokes[1:]), ("val_grey", (None, None))):
                x = network_input(stokes[0] / 2, *channels, _normalized(sample["camera"]))
                error, tolerance = aligned_error(network(torch.from_numpy(x[None]))[0], truth)
                figures[name].append(float((error.abs() / tolerance).clamp(max=1.0).mean()))
    return {name: round(float(np.mean(values)), 4) for name, values in figures.items()}


def _normalized(camera: np.ndarray) -> np.ndarray:
    fx, fy, cx, cy = camera
    x, y = (np.arange(_SIZE[1]) - cx) / fx, (np.arange(_SIZE[0]) - cy) / fy
    return np.stack(np.meshgrid(x, y), axis=-1).astype(np.float32)
