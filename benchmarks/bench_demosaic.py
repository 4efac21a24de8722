"""DoLP error at edges, and time, of the demosaicing methods, on full-resolution renders of the built-in room.

The room is rendered at the mosaic's resolution, each mosaic pixel averaging 3×3 rays over its area, once as
such and once behind a lens that blurs by 0.7 mosaic pixels. Each pixel keeps its own polarizer's share of its own
Stokes vector; noise and 8-bit quantization follow. The truth at a block is the DoLP of the mean Stokes vector of
its four pixels. Edge pixels are within 2 pixels (of the 640x480 result) of a step of over 15 % in S0 or over 0.05 in
DoLP between neighbours.

    python benchmarks/bench_demosaic.py
"""

from __future__ import annotations

import time

import cv2
import numpy as np
from rich.console import Console
from rich.table import Table

from polarmap.data.sensor import SensorLayout, SensorNoise
from polarmap.geometry.camera import PinholeCamera
from polarmap.sensing.mosaic import METHODS, demosaic
from polarmap.sensing.stokes import polarization_image
from polarmap.synth.scenes import built_in_scene
from polarmap.synth.sensor import Sensor
from polarmap.synth.shading import render

CAMERA = PinholeCamera(640, 480, 480.0, 480.0, 319.5, 239.5).scaled(2.0)
LAYOUT = SensorLayout.SONY_POLARSENS
BIT_DEPTH = 8
VIEWS = 3
BLURS = (0.0, 0.7)


def main() -> None:
    table = Table(title="DoLP error at edges / elsewhere")
    for heading in ("method", *(f"lens blur {blur} px" for blur in BLURS), "milliseconds"):
        table.add_column(heading, justify="left" if heading == "method" else "right")
    for method, errors, milliseconds in measure():
        cells = [f"{at_edges:.4f} / {elsewhere:.4f}" for at_edges, elsewhere in errors]
        table.add_row(method, *cells, f"{milliseconds:.1f}")
    Console().print(table)


def measure() -> list[tuple[str, list[np.ndarray], float]]:
    """Per method: the errors (at edges, elsewhere) for each blur, and the time of one mosaic."""
    views = full_resolution_stokes()
    errors = {method: [] for method in METHODS}
    for blur in BLURS:
        captured = [capture(blurred(stokes, blur), index) for index, stokes in enumerate(views)]
        for method in METHODS:
            errors[method].append(np.mean([dolp_errors(*pair, method) for pair in captured], axis=0))
    mosaic = captured[0][0]
    return [(method, errors[method], milliseconds(mosaic, method)) for method in METHODS]


def full_resolution_stokes() -> list[np.ndarray]:
    room = built_in_scene("room")
    _, poses = room.path(frames=VIEWS, step=0.3)
    return [render(room.scene, CAMERA, pose, supersample=3).stokes for pose in poses]


def blurred(stokes: np.ndarray, sigma: float) -> np.ndarray:
    return np.stack([cv2.GaussianBlur(s, (0, 0), sigma) for s in stokes]) if sigma > 0 else stokes


def capture(stokes: np.ndarray, index: int) -> tuple[np.ndarray, np.ndarray]:
    """The mosaic as shares of full scale, and the true Stokes vectors of its blocks."""
    raw = Sensor(LAYOUT, bit_depth=BIT_DEPTH, sub_pixel=True).capture(stokes, index)
    _, height, width = stokes.shape
    blocks = stokes.reshape(3, height // 2, 2, width // 2, 2).mean(axis=(2, 4))
    return raw.astype(np.float32) / (2**BIT_DEPTH - 1), blocks


def dolp_errors(mosaic: np.ndarray, stokes: np.ndarray, method: str) -> tuple[float, float]:
    image = polarization_image(demosaic(mosaic, LAYOUT, method), SensorNoise(), BIT_DEPTH)
    truth = np.hypot(stokes[1], stokes[2]) / np.maximum(stokes[0], 1e-6)
    error, edges = np.abs(image.dolp - truth), near_edges(stokes[0], truth)
    counted = ~image.saturated & ~image.underexposed
    return error[edges & counted].mean(), error[~edges & counted].mean()


def near_edges(s0: np.ndarray, dolp: np.ndarray) -> np.ndarray:
    steps = (largest_step(np.log(np.maximum(s0, 1e-6))) > 0.15) | (largest_step(dolp) > 0.05)
    return cv2.dilate(steps.astype(np.uint8), np.ones((5, 5), np.uint8)) > 0


def largest_step(image: np.ndarray) -> np.ndarray:
    """Of each pixel to its right and lower neighbour."""
    right = np.abs(np.diff(image, axis=1, append=image[:, -1:]))
    down = np.abs(np.diff(image, axis=0, append=image[-1:]))
    return np.maximum(right, down)


def milliseconds(mosaic: np.ndarray, method: str, runs: int = 10) -> float:
    demosaic(mosaic, LAYOUT, method)
    times = []
    for _ in range(runs):
        start = time.perf_counter()
        demosaic(mosaic, LAYOUT, method)
        times.append(time.perf_counter() - start)
    return 1e3 * min(times)


if __name__ == "__main__":
    main()
