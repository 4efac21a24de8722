"""How good networks are on recordings that they were not trained on, as a table.

    python -m training.evaluate RUN/checkpoint.pt src/polarmap/prior/polarnet.onnx tcmonodepth_small.onnx --data DATA
    python -m training.evaluate polarnet.onnx --data DATA --office-blinn-phong DIR --office-fresnel DIR --pictures OUT

Relative inverse depth is aligned to the true one by the affine map of least mean absolute error, rising or constant;
the figure is the mean over frames of the mean AbsRel over all pixels with truth. DATA holds the folders `livingroom`,
`icl_office_kt0` and `redwood_livingroom1`. Pictures of RGB-D recordings are taken for sRGB: intensity is their 1/0.45th
power.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from polarmap.geometry.camera import PinholeCamera
from polarmap.io.sequence import open_sequence
from polarmap.polarization.frontend import PolarizationFrontEnd
from polarmap.polarization.types import PolarizationImage
from polarmap.prior import DepthNetwork, Network, PolarNetwork

_REWEIGHTINGS = 30
_FARTHEST = 4.0  # times the true depth of nearly all pixels: what the fit may give at most


@dataclass(frozen=True)
class View:
    """A picture with its true depth, NaN where there is none."""

    image: PolarizationImage
    depth: np.ndarray
    camera: PinholeCamera


def main() -> None:
    """Print the table; write pictures where asked to."""
    arguments = _arguments()
    cv2.setNumThreads(2)
    networks = {path.stem: _network(path) for path in arguments.networks}
    width = max(map(len, networks))
    sets = dict(_sets(arguments))
    print("AbsRel after affine fit (frames where the fit has the right sign)")
    for title, (views, grey) in sets.items():
        for name, network in networks.items():
            if not grey and not isinstance(network, PolarNetwork):
                continue
            errors, found, fitted = evaluate(network, views, grey)
            print(f"{title:34} {'grey' if grey else 'polarized':9} {name:{width}} {np.mean(errors):.3f} "
                  f"({fitted}/{len(errors)})", flush=True)  # fmt: skip
            if arguments.pictures:
                _write_picture(arguments.pictures / f"{title} {name} {'grey' if grey else 'pol'}.png", views, found)


def evaluate(network: Network, views: list[View], grey: bool) -> tuple[list[float], list[np.ndarray], int]:
    """AbsRel and aligned inverse depth of each view, with polarization or from its intensity alone.

    The third is the number of views whose fit is not constant, so whose near and far are not turned around.
    """
    errors, found, fitted = [], [], 0
    for view in views:
        image = PolarizationImage.unpolarized(view.image.intensity) if grey else view.image
        relative = network.predict(image, view.camera).relative_inverse_depth
        known = np.isfinite(view.depth)
        truth = 1.0 / view.depth[known].astype(np.float64)
        scale, offset = robust_fit(relative[known].astype(np.float64), truth)
        inverse_depth = np.maximum(scale * relative + offset, np.quantile(truth, 0.005) / _FARTHEST)
        errors.append(float(np.mean(np.abs(truth / inverse_depth[known] - 1.0))))
        fitted += scale > 0
        found.append(inverse_depth)
    return errors, found, fitted


def robust_fit(d: np.ndarray, q: np.ndarray) -> tuple[float, float]:
    """a >= 0 and b of the least mean |a d + b - q|, by reweighted least squares."""
    weights, a, b = np.ones_like(q), 0.0, float(np.median(q))
    for _ in range(_REWEIGHTINGS):
        total = weights.sum()
        d_mean, q_mean = weights @ d / total, weights @ q / total
        a = max(weights @ ((d - d_mean) * (q - q_mean)) / max(weights @ np.square(d - d_mean), 1e-12), 0.0)
        b = q_mean - a * d_mean
        weights = 1.0 / np.maximum(np.abs(a * d + b - q), 1e-4)
    return float(a), float(b)


def _network(path: Path) -> Network:
    if path.suffix == ".pt":
        from training.export import export, load

        with tempfile.TemporaryDirectory() as folder:
            export(*load(path), Path(folder) / "network.onnx")
            return PolarNetwork(Path(folder) / "network.onnx")
    return DepthNetwork(path) if "polarnet" not in path.stem else PolarNetwork(path)


def _sets(arguments: argparse.Namespace) -> Iterator[tuple[str, tuple[list[View], bool]]]:
    data = arguments.data
    if data:
        living = _polarized(data / "livingroom", 8)
        yield "livingroom, every 8th", (living, False)
        yield "livingroom, every 8th ", (living, True)
        yield "redwood_livingroom1, every 30th", (list(_redwood(data / "redwood_livingroom1", 30)), True)
        yield "icl_office_kt0, every 60th", (list(_office(data / "icl_office_kt0", 60)), True)
    for title, folder in (("blinn-phong", arguments.office_blinn_phong), ("fresnel", arguments.office_fresnel)):
        if folder:
            yield f"icl_office_kt0 {title}, every 60th", (_polarized(folder, 60), False)
    for folder in arguments.scenes:
        views = _polarized(folder, 10)
        yield folder.name, (views, False)
        yield f"{folder.name} ", (views, True)


def _polarized(folder: Path, step: int) -> list[View]:
    sequence = open_sequence(folder)
    front_end = PolarizationFrontEnd(sequence.camera_file)
    frames = [frame for i, frame in enumerate(sequence) if i % step == 0]
    scale = 1.0 / sequence.camera_file.depth_scale
    return [
        View(front_end(frame), _depth(folder / "depth" / f"{frame.path.stem}.png", scale), front_end.camera)
        for frame in frames
    ]


def _redwood(folder: Path, step: int) -> Iterator[View]:
    camera = PinholeCamera(640, 480, 525.0, 525.0, 319.5, 239.5)
    for path in sorted((folder / "image").glob("*.jpg"))[::step]:
        yield View(_grey(path), _depth(folder / "depth" / f"{path.stem}.png", 1e-3), camera)


def _office(folder: Path, step: int) -> Iterator[View]:
    camera = PinholeCamera(640, 480, 481.2, 480.0, 319.5, 239.5)
    for path in sorted((folder / "gray").glob("*.png"))[::step]:
        yield View(_grey(path), _depth(folder / "depth" / path.name, 1 / 5000), camera)


def _grey(path: Path) -> PolarizationImage:
    encoded = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE).astype(np.float32) / 255
    return PolarizationImage.unpolarized(encoded ** np.float32(1 / 0.45))


def _depth(path: Path, metres: float) -> np.ndarray:
    values = cv2.imread(str(path), cv2.IMREAD_UNCHANGED).astype(np.float32)
    return np.where(values > 0, values * np.float32(metres), np.nan)


def _write_picture(path: Path, views: list[View], found: list[np.ndarray]) -> None:
    """Each view: intensity, true inverse depth, what was found."""
    rows = []
    for view, inverse_depth in zip(views, found, strict=True):
        truth = np.nan_to_num(1.0 / view.depth)
        low, high = np.quantile(truth[truth > 0], [0.01, 0.99])
        grey = np.clip((view.image.intensity / np.percentile(view.image.intensity, 99)) ** 0.45, 0, 1)
        tiles = [cv2.merge([(255 * grey).astype(np.uint8)] * 3)]
        for q in (truth, inverse_depth):
            share = np.clip((q - low) / (high - low), 0, 1)
            tiles.append(cv2.applyColorMap((255 * share).astype(np.uint8), cv2.COLORMAP_MAGMA))
        rows.append(cv2.resize(np.hstack(tiles), None, fx=0.4, fy=0.4, interpolation=cv2.INTER_AREA))
    path.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(path), np.vstack(rows))


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("networks", type=Path, nargs="+", help="checkpoints (.pt) and ONNX files")
    parser.add_argument("--data", type=Path, help="folder of the recordings")
    parser.add_argument("--office-blinn-phong", type=Path, help="the office by 'polarmap synth rgbd'")
    parser.add_argument("--office-fresnel", type=Path, help="the same with --model fresnel")
    parser.add_argument("--scenes", type=Path, nargs="*", default=[], help="recordings of the package's own scenes")
    parser.add_argument("--pictures", type=Path, help="folder for pictures")
    return parser.parse_args()


if __name__ == "__main__":
    main()
