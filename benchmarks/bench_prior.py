"""How good depth priors are between simulated points, and how long they take.

Points lie where stereo finds them, on a share of the pixels with the strongest gradients, with 0.5 % noise and 5 % that
are anywhere. The figure is the mean AbsRel over the pixels without points, and in brackets in how many of the frames
the network was found fit for use. PATH is a polarization recording with true depth, or an RGB-D one, whose pictures are
taken for sRGB; each STEPth of its frames is used. Networks are `polarnet` or ONNX files.

    python benchmarks/bench_prior.py PATH STEP NETWORK...
    python benchmarks/bench_prior.py ../shared/data/livingroom 6 polarnet tcmonodepth_small_192x320.onnx
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from rich.console import Console
from rich.table import Table

from polarmap.data.polarization_image import PolarizationImage
from polarmap.geometry.camera import PinholeCamera
from polarmap.io.recording.rgbd.formats import open_rgbd
from polarmap.io.recording.sequence import open_sequence
from polarmap.prior.options import PriorOptions
from polarmap.prior.priors import Prior, make_prior
from polarmap.sensing.front_end import FrontEnd

SHARES = (0.01, 0.05, 0.2, 0.4)
NOISE, WRONG = 0.005, 0.05


class View(NamedTuple):
    """A picture and its true depth, float32 H×W metres, NaN where there is none."""

    image: PolarizationImage
    depth: np.ndarray
    camera: PinholeCamera


def main() -> None:
    """Print the table."""
    if len(sys.argv) < 3:
        sys.exit(__doc__)
    views = list(recorded(Path(sys.argv[1]), int(sys.argv[2])))
    priors: dict[str, Prior] = {"sparse": make_prior("sparse")}
    for name in sys.argv[3:]:
        priors[f"{Path(name).stem}, aligned"] = make_prior(name, PriorOptions(refine=False))
        priors[f"{Path(name).stem}, bent"] = make_prior(name)
    table = Table(title=f"{sys.argv[1]}, {len(views)} frames: AbsRel between the points", box=None)
    for column in ("points", *priors):
        table.add_column(column, justify="right")
    milliseconds = {name: [] for name in priors}
    for share in SHARES:
        row = [judged(prior, views, share, milliseconds[name]) for name, prior in priors.items()]
        table.add_row(f"{100 * share:.0f} %", *row)
    table.add_row("ms", *(f"{np.median(times):.0f}" for times in milliseconds.values()))
    Console(width=160).print(table)


def recorded(path: Path, step: int) -> Iterator[View]:
    """Each `step`th frame of a recording."""
    if not (path / "camera.yaml").is_file():
        sequence = open_rgbd(path)[::step]
        for frame in sequence:
            yield View(
                PolarizationImage.unpolarized(frame.picture ** np.float32(1 / 0.45)), frame.depth, sequence.camera
            )
        return
    sequence = open_sequence(path)
    front_end = FrontEnd(sequence.camera_file)
    for frame in sequence[::step]:
        yield View(front_end.polarization(frame), sequence.truth_depth(frame.index), front_end.camera)


def judged(prior: Prior, views: list[View], share: float, milliseconds: list[float]) -> str:
    """AbsRel between the points, and how often a network was used."""
    errors, used, network = [], 0, False
    for number, view in enumerate(views):
        points = simulated_points(view, share, np.random.default_rng(number))
        start = time.perf_counter()
        found = prior(view.image, points, view.camera)
        milliseconds.append(1e3 * (time.perf_counter() - start))
        between = np.isfinite(view.depth) & np.isnan(points)
        errors.append(np.mean(np.abs(found.depth / view.depth - 1.0)[between]))
        network |= found.alignment is not None
        used += found.alignment is not None and found.alignment.accepted
    return f"{np.mean(errors):.3f}" + (f" ({used}/{len(views)})" if network else "")


def simulated_points(view: View, share: float, rng: np.random.Generator) -> np.ndarray:
    """Depth at the strongest gradients, float32 H×W, NaN elsewhere."""
    smooth = cv2.GaussianBlur(np.sqrt(view.image.intensity), (0, 0), 1.0)
    gradient = np.hypot(cv2.Sobel(smooth, cv2.CV_32F, 1, 0), cv2.Sobel(smooth, cv2.CV_32F, 0, 1))
    depth = view.depth * (1.0 + NOISE * rng.standard_normal(view.depth.shape))
    wrong = rng.random(depth.shape) < WRONG
    depth[wrong] = rng.uniform(np.nanmin(view.depth), np.nanmax(view.depth), np.count_nonzero(wrong))
    seen = np.isfinite(view.depth) & (gradient >= np.quantile(gradient, 1.0 - share))
    return np.where(seen, depth, np.nan).astype(np.float32)


if __name__ == "__main__":
    main()
