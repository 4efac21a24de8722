"""How good networks are on recordings that they were not trained on, as a table.

    python -m training.evaluate RUN/checkpoint.pt src/polarmap/prior/polarnet.onnx tcmonodepth_small.onnx --data DATA
    python -m training.evaluate polarnet.onnx --data DATA --office-blinn-phong DIR --office-fresnel DIR --pictures OUT

Relative inverse depth is aligned to the true one by the affine map of least mean absolute error, rising or constant;
the figure is the mean over frames of the mean AbsRel over all pixels with truth. Beside it: in how many frames the fit
rises, and of networks that state a standard deviation the share of the errors within it. DATA holds the folders
`livingroom`, `icl_office_kt0`, `redwood_livingroom1` and `raw_imx250mzr`. Pictures of RGB-D recordings are taken for
sRGB: intensity is their 1/0.45th power. With --pictures also mosaics of a real camera are shown; they have no truth.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from polarmap.data.camera_file import CameraFile
from polarmap.data.polarization_image import PolarizationImage
from polarmap.data.sensor import AngleDirection, SensorLayout
from polarmap.errors import InputError
from polarmap.geometry.camera import PinholeCamera
from polarmap.io.formats.depth_png import read_depth_png
from polarmap.io.recording.sequence import open_sequence
from polarmap.prior.network import DepthNetwork
from polarmap.prior.polarization_network import PolarNetwork
from polarmap.prior.priors import Network
from polarmap.sensing.front_end import FrontEnd

_REWEIGHTINGS = 30
_FARTHEST = 4.0  # times the true depth of nearly all pixels: what the fit may give at most


@dataclass(frozen=True)
class View:
    """A picture with its true depth, NaN where there is none."""

    image: PolarizationImage
    depth: np.ndarray
    camera: PinholeCamera


@dataclass(frozen=True)
class Judgement:
    """Of one view: mean AbsRel, the aligned inverse depth, whether near and far are not turned around, and the share of
    the errors within the network's standard deviation, NaN where it states none."""

    error: float
    inverse_depth: np.ndarray
    rises: bool
    within_sigma: float


def main() -> None:
    """Print the table; write pictures where asked to."""
    arguments = _arguments()
    cv2.setNumThreads(2)
    networks = [_network(path) for path in arguments.networks]
    names = _short_names(arguments.networks)
    width = max(map(len, names))
    print("AbsRel after affine fit (frames where the fit rises; errors within the network's own sigma)")
    for title, views, grey in _sets(arguments):
        for name, network in zip(names, networks, strict=True):
            if not grey and not isinstance(network, PolarNetwork):
                continue
            judged = [judge(network, view, grey) for view in views]
            within = np.mean([j.within_sigma for j in judged])
            print(f"{title:34} {'grey' if grey else 'polarized':9} {name:{width}} "
                  f"{np.mean([j.error for j in judged]):.3f} ({sum(j.rises for j in judged)}/{len(judged)}"
                  f"{'' if np.isnan(within) else f'; {100 * within:.0f} %'})", flush=True)  # fmt: skip
            if arguments.pictures:
                path = arguments.pictures / f"{title} {name} {'grey' if grey else 'polarized'}.png"
                _write_picture(path, views, [j.inverse_depth for j in judged])
    if arguments.pictures and arguments.data and (arguments.data / "raw_imx250mzr").is_dir():
        _write_mosaics(arguments.pictures / "mosaics.png", arguments.data / "raw_imx250mzr", networks)


def judge(network: Network, view: View, grey: bool) -> Judgement:
    """A network's view of a picture, with polarization or from its intensity alone, against the truth."""
    prediction = network.predict(
        PolarizationImage.unpolarized(view.image.intensity) if grey else view.image, view.camera
    )
    relative = prediction.relative_inverse_depth
    known = np.isfinite(view.depth)
    truth = 1.0 / view.depth[known].astype(np.float64)
    scale, offset = robust_fit(relative[known].astype(np.float64), truth)
    inverse_depth = np.maximum(scale * relative + offset, np.quantile(truth, 0.005) / _FARTHEST)
    errors = np.abs(truth / inverse_depth[known] - 1.0)
    sigma = prediction.sigma_depth
    within = np.nan if sigma is None else float(np.mean(errors < sigma[known]))
    return Judgement(float(errors.mean()), inverse_depth, scale > 0, within)


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


def _short_names(paths: list[Path]) -> list[str]:
    """Of files, with their folder where names alone are not enough."""
    stems = [path.stem for path in paths]
    return [s if stems.count(s) == 1 else f"{p.resolve().parent.name}/{s}" for p, s in zip(paths, stems, strict=True)]


def _network(path: Path) -> Network:
    if path.suffix == ".pt":
        from training.export import export, load

        with tempfile.TemporaryDirectory() as folder:
            export(*load(path), Path(folder) / "network.onnx")
            return PolarNetwork(Path(folder) / "network.onnx")
    try:
        return PolarNetwork(path)
    except InputError:
        return DepthNetwork(path)


def _sets(arguments: argparse.Namespace) -> Iterator[tuple[str, list[View], bool]]:
    """Title, views, and whether they are shown in grey alone."""
    data = arguments.data
    if data:
        living = _polarized(data / "livingroom", 8)
        yield "livingroom, every 8th", living, False
        yield "livingroom, every 8th", living, True
        yield "redwood_livingroom1, every 30th", list(_redwood(data / "redwood_livingroom1", 30)), True
        yield "icl_office_kt0, every 60th", list(_office(data / "icl_office_kt0", 60)), True
    for title, folder in (("blinn-phong", arguments.office_blinn_phong), ("fresnel", arguments.office_fresnel)):
        if folder:
            yield f"icl_office_kt0 {title}", _polarized(folder, 1), False
    for folder in arguments.scenes:
        views = _polarized(folder, 10)
        yield folder.name, views, False
        yield folder.name, views, True


def _polarized(folder: Path, step: int) -> list[View]:
    sequence = open_sequence(folder)
    front_end = FrontEnd(sequence.camera_file)
    return [View(front_end.polarization(f), sequence.truth_depth(f.index), front_end.camera) for f in sequence[::step]]


def _redwood(folder: Path, step: int) -> Iterator[View]:
    camera = PinholeCamera(640, 480, 525.0, 525.0, 319.5, 239.5)
    for path in sorted((folder / "image").glob("*.jpg"))[::step]:
        yield View(_grey(path), read_depth_png(folder / "depth" / f"{path.stem}.png", 1000.0), camera)


def _office(folder: Path, step: int) -> Iterator[View]:
    camera = PinholeCamera(640, 480, 481.2, 480.0, 319.5, 239.5)
    for path in sorted((folder / "gray").glob("*.png"))[::step]:
        yield View(_grey(path), read_depth_png(folder / "depth" / path.name, 5000.0), camera)


def _grey(path: Path) -> PolarizationImage:
    encoded = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE).astype(np.float32) / 255
    return PolarizationImage.unpolarized(encoded ** np.float32(1 / 0.45))


def _write_mosaics(path: Path, folder: Path, networks: Iterable[Network]) -> None:
    """Real mosaics: intensity, degree of polarization, and the relative inverse depth of each network."""
    camera = PinholeCamera(1224, 1024, 1900.0, 1900.0, 611.5, 511.5)  # its lens is not known
    rows = []
    for mosaic in sorted(folder.glob("*.png")):
        file = CameraFile(camera, SensorLayout.SONY_POLARSENS, AngleDirection.COUNTERCLOCKWISE, 8, demosaic="split")
        image = FrontEnd(file).polarization(open_sequence(mosaic, file)[0])
        tiles = [_grey_tile(image.intensity), _colour_tile(image.dolp, 0.0, 1.0)]
        for network in networks:
            relative = network.predict(image, camera).relative_inverse_depth
            tiles.append(_colour_tile(relative, *np.quantile(relative, [0.01, 0.99])))
        rows.append(cv2.resize(np.hstack(tiles), None, fx=0.2, fy=0.2, interpolation=cv2.INTER_AREA))
    cv2.imwrite(str(path), np.vstack(rows))


def _grey_tile(intensity: np.ndarray) -> np.ndarray:
    grey = np.clip((intensity / np.percentile(intensity, 99)) ** 0.45, 0, 1)
    return cv2.merge([(255 * grey).astype(np.uint8)] * 3)


def _colour_tile(values: np.ndarray, low: float, high: float) -> np.ndarray:
    share = np.clip((values - low) / (high - low), 0, 1)
    return cv2.applyColorMap((255 * share).astype(np.uint8), cv2.COLORMAP_MAGMA)


def _write_picture(path: Path, views: list[View], found: list[np.ndarray]) -> None:
    """Each view: intensity, true inverse depth, what was found."""
    rows = []
    for view, inverse_depth in zip(views, found, strict=True):
        truth = np.nan_to_num(1.0 / view.depth)
        low, high = np.quantile(truth[truth > 0], [0.01, 0.99])
        tiles = [_grey_tile(view.image.intensity), *(_colour_tile(q, low, high) for q in (truth, inverse_depth))]
        rows.append(cv2.resize(np.hstack(tiles), None, fx=0.4, fy=0.4, interpolation=cv2.INTER_AREA))
    path.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(path), np.vstack(rows))


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("networks", type=Path, nargs="+", help="checkpoints (.pt) and ONNX files")
    parser.add_argument("--data", type=Path, help="folder of the recordings")
    parser.add_argument("--office-blinn-phong", type=Path, help="the office by 'polarmap synth rgbd --frames 0:449:60'")
    parser.add_argument("--office-fresnel", type=Path, help="the same with --model fresnel")
    parser.add_argument("--scenes", type=Path, nargs="*", default=[], help="recordings of the package's own scenes")
    parser.add_argument("--pictures", type=Path, help="folder for pictures")
    return parser.parse_args()


if __name__ == "__main__":
    main()
