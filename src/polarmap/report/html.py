"""The report of a run: one self-contained HTML page made of what stands in the run's folder."""

from __future__ import annotations

import base64
import logging
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import fmean

import cv2
import numpy as np
from jinja2 import Environment, PackageLoader
from markupsafe import Markup

from polarmap.errors import InputError
from polarmap.evaluation.records import Evaluation, read_evaluation
from polarmap.io.files import read_text, write_bytes
from polarmap.io.formats.images import MAX_PIXELS, read_colours
from polarmap.io.run_folder.folder import CONFIG_NAME, EVALUATION_NAME, REPORT_NAME, read_results
from polarmap.io.run_folder.results import KeyframeSummary, RunResults
from polarmap.report import pictures, plots
from polarmap.report.evaluation_tables import STAGE_TITLES
from polarmap.report.keyframe_pictures import PICTURES

log = logging.getLogger(__name__)

_PICTURE_WIDTH = 400  # pixels, at most
_MAP_WIDTH = 960
_MOST_MAP_PIXELS = 1 << 22
_JPEG_QUALITY = 78
_PICTURE_BYTES = 12_000_000  # of all keyframes' pictures together, as data URLs


@dataclass(frozen=True)
class _PicturedKeyframe:
    """pictures: (what is shown, data URL)."""

    summary: KeyframeSummary
    pictures: list[tuple[str, str]]

    @property
    def size(self) -> int:
        return sum(len(url) for _, url in self.pictures)


def write_report(out: Path, max_pictured: int = 48) -> Path:
    """Write report.html from the results and pictures in a run's folder; returns its path.

    Shows an evaluation too if evaluation.json is there. At most `max_pictured` keyframes are shown with pictures,
    evenly sampled, fewer where those would take more than 12 MB. Raises InputError where the folder is not that of
    a run or a file in it is malformed, PolarmapError where the page cannot be written.
    """
    out = Path(out)
    results = read_results(out)
    evaluation = read_evaluation(out / EVALUATION_NAME) if (out / EVALUATION_NAME).exists() else None
    page = _environment().get_template("report_template.html").render(
        results=results,
        evaluation=evaluation,
        tiles=_tiles(results, evaluation),
        plots=_plots(results),
        accuracy_plot=_accuracy_plot(evaluation),
        frames=_pictured(out, results, max_pictured),
        map_views=_map_views(out),
        wheel=_jpeg_url(pictures.aolp_wheel()[..., ::-1].copy()),
        origin_colours=_legend(("none", "stereo", "propagated", "estimated"), pictures.ORIGIN_COLOURS),
        label_colours=_legend(("none", "diffuse", "specular", "metal"), pictures.LABEL_COLOURS),
        stage_titles=STAGE_TITLES,
        config=read_text(out / CONFIG_NAME) if (out / CONFIG_NAME).exists() else "",
    )  # fmt: skip
    write_bytes(out / REPORT_NAME, page.encode())
    return out / REPORT_NAME


def _environment() -> Environment:
    environment = Environment(
        loader=PackageLoader("polarmap", "report"), autoescape=True, trim_blocks=True, lstrip_blocks=True
    )
    environment.filters["percent"] = lambda share, digits=1: _number(share, lambda v: f"{100 * v:.{digits}f} %")
    environment.filters["fixed"] = lambda value, digits=4: _number(value, lambda v: f"{v:.{digits}f}")
    environment.filters["count"] = lambda value: _number(value, lambda v: f"{v:,.0f}".replace(",", "\u202f"))
    return environment


def _number(value: float | None, text) -> str:
    return "–" if value is None or value != value else text(value)


def _tiles(results: RunResults, evaluation: Evaluation | None) -> list[tuple[str, str]]:
    """The figures at the top: (value, meaning)."""
    keyframes = results.keyframes
    tiles = [(str(len(keyframes)), f"keyframes of {results.frames} frames")]
    if keyframes:
        tiles.append((f"{100 * fmean(k.density for k in keyframes):.1f} %", "of the pixels have depth"))
        tiles.append((f"{fmean(sum(k.milliseconds.values()) for k in keyframes) / 1000:.2f} s", "per keyframe"))
    if evaluation is not None:
        tiles.append((f"{evaluation.depth.abs_rel:.4f}", "AbsRel"))
        tiles.append((f"{100 * evaluation.depth.within:.1f} %", "of all pixels within 2 % of the truth"))
    if results.map is not None:
        tiles.append((f"{results.map.faces:,}".replace(",", "\u202f"), "triangles in the mesh"))
    return tiles


def _plots(results: RunResults) -> list[tuple[str, Markup]]:
    """(title, SVG) of each plot over the keyframes."""
    if not results.keyframes:
        return []
    live = results.live
    return [
        ("Density", Markup(plots.density_plot(results.keyframes))),
        ("Time", Markup(plots.time_plot(results.keyframes))),
        *([("Live", Markup(plots.live_plot(live)))] if live is not None and live.moments else []),
    ]


def _accuracy_plot(evaluation: Evaluation | None) -> Markup | None:
    if evaluation is None:
        return None
    return Markup(plots.accuracy_plot(evaluation.curve.density, evaluation.curve.abs_rel))


def _pictured(out: Path, results: RunResults, most: int) -> list[_PicturedKeyframe]:
    """Evenly sampled keyframes with their pictures, as many as fit."""
    pixels = min(results.camera.width * results.camera.height, MAX_PIXELS)
    found = [_with_pictures(out, keyframe, pixels) for keyframe in _evenly(results.keyframes, most)]
    total = sum(frame.size for frame in found)
    return found if total <= _PICTURE_BYTES else _evenly(found, max(1, len(found) * _PICTURE_BYTES // total))


def _evenly(items: Sequence, most: int) -> list:
    chosen = np.unique(np.linspace(0, len(items) - 1, min(most, len(items))).round().astype(int))
    return [items[i] for i in chosen]


def _with_pictures(out: Path, keyframe: KeyframeSummary, pixels: int) -> _PicturedKeyframe:
    """The keyframe with its pictures, which have so many pixels."""
    files = [
        (title, out / "pictures" / f"{keyframe.index:06d}_{kind}.{suffix}")
        for kind, (title, suffix) in PICTURES.items()
    ]
    return _PicturedKeyframe(keyframe, list(_shrunk(files, _PICTURE_WIDTH, pixels)))


def _map_views(out: Path) -> list[tuple[str, str]]:
    views = {"outside": "from outside", "top": "from above"}
    files = [(title, out / "pictures" / f"map_{view}.jpg") for view, title in views.items()]
    return list(_shrunk(files, _MAP_WIDTH, _MOST_MAP_PIXELS))


def _shrunk(files: Iterable[tuple[str, Path]], width: int, most_pixels: int) -> Iterable[tuple[str, str]]:
    """(title, data URL) of the pictures that are there, at most `width` pixels wide.

    One that cannot be read, or has more than `most_pixels` pixels, is left out with a warning.
    """
    for title, path in files:
        if not path.exists():
            continue
        try:
            picture = read_colours(path, most_pixels)
        except InputError as problem:
            log.warning("left out of the report: %s", problem)
            continue
        if picture.shape[1] > width:
            size = width, max(1, round(picture.shape[0] * width / picture.shape[1]))
            picture = cv2.resize(picture, size, interpolation=cv2.INTER_AREA)
        yield title, _jpeg_url(picture)


def _jpeg_url(bgr: np.ndarray) -> str:
    """An image as a data URL."""
    _, data = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
    return f"data:image/jpeg;base64,{base64.b64encode(data).decode()}"


def _legend(names: Sequence[str], colours: Sequence[tuple[int, int, int]]) -> list[tuple[str, str]]:
    """(name, CSS colour)."""
    return [(name, "#{:02x}{:02x}{:02x}".format(*colour)) for name, colour in zip(names, colours, strict=True)]
