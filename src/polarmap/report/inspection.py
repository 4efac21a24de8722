"""What is in a recorded sequence: exposure, polarization, noise, and pictures to look at."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np
from rich.table import Table

from polarmap.data.polarization_image import PolarizationImage
from polarmap.errors import InputError, PolarmapError
from polarmap.io.files import reason
from polarmap.io.formats.images import write_image
from polarmap.report import pictures
from polarmap.sensing.front_end import FrontEnd
from polarmap.sensing.mosaic_check import check_mosaic
from polarmap.sensing.stokes import consistency_residual

if TYPE_CHECKING:
    from polarmap.data.frame import Frame
    from polarmap.io.recording.sequence import Sequence

POLARIZED = 0.05  # DoLP from which an angle tells something about a surface
OVERVIEW_WIDTH = 1200  # pixels
_WHEEL_SHARE = 0.16  # of the overview's panel height


@dataclass(frozen=True)
class FrameInspection:
    """One frame. Shares are of its pixels; NaN where no pixel counts.

    lowest, highest: raw pixel values.
    saturated, underexposed: shares clipped at the top, and too dark.
    dolp: median degree of linear polarization.
    polarized: share with a DoLP above 0.05.
    residual: median of |(I0 + I90) - (I45 + I135)| / S0.
    sigma_aolp, sigma_aolp_polarized: median standard deviation of the angle, degrees, of all pixels and of
        those with a DoLP above 0.05.
    """

    index: int
    name: str
    timestamp: float
    lowest: int
    highest: int
    saturated: float
    underexposed: float
    dolp: float
    polarized: float
    residual: float
    sigma_aolp: float
    sigma_aolp_polarized: float


@dataclass(frozen=True)
class Inspection:
    """A sequence and some of its frames.

    width, height: of the polarization images.
    duration: seconds from the first to the last frame; NaN where the sequence has no times.
    rate: frames per second; NaN for a single frame or without times.
    findings: what in the frames contradicts the camera file, one line each (`check_mosaic`).
    """

    path: str
    frame_count: int
    width: int
    height: int
    bit_depth: int
    demosaic: str
    angle_direction: str
    duration: float
    rate: float
    frames: tuple[FrameInspection, ...]
    findings: tuple[str, ...] = ()


def inspect_sequence(sequence: Sequence, samples: int = 5, pictures_to: Path | None = None) -> Inspection:
    """Look at `samples` frames spread evenly over the sequence, and write their pictures if a folder is given.

    Holds one frame in memory at a time, and the middles of five. Raises InputError for an empty sequence or a frame
    that cannot be read, PolarmapError where a picture cannot be written.
    """
    if len(sequence) == 0:
        raise InputError(f"{sequence.path}: no frames")
    front_end = FrontEnd(sequence.camera_file)
    last = len(sequence) - 1
    chosen = sorted({round(i) for i in np.linspace(0, last, min(samples, last + 1))})
    frames = tuple(_inspect_frame(sequence[i], front_end, pictures_to) for i in chosen)
    findings = check_mosaic((_raw(sequence[i]) for i in chosen), sequence.camera_file)
    return _summary(sequence, frames, findings)


def _raw(frame: Frame) -> np.ndarray:
    return frame.channels if frame.mosaic is None else frame.mosaic


def _summary(sequence: Sequence, frames: tuple[FrameInspection, ...], findings: tuple[str, ...]) -> Inspection:
    file = sequence.camera_file
    first, last = sequence.timestamps[[0, -1]]
    duration = float(last - first)
    return Inspection(
        path=str(sequence.path),
        frame_count=len(sequence),
        width=file.camera.width,
        height=file.camera.height,
        bit_depth=file.bit_depth,
        demosaic=file.demosaic,
        angle_direction=file.angle_direction.value,
        duration=duration,
        rate=(len(sequence) - 1) / duration if duration > 0 else float("nan"),
        frames=frames,
        findings=findings,
    )


def _inspect_frame(frame: Frame, front_end: FrontEnd, pictures_to: Path | None) -> FrameInspection:
    image = front_end.polarization(frame)
    raw = _raw(frame)
    polarized = image.dolp > POLARIZED
    if pictures_to is not None:
        write_pictures(pictures_to, frame.name, image)
    return FrameInspection(
        index=frame.index,
        name=frame.name,
        timestamp=frame.timestamp,
        lowest=int(raw.min()),
        highest=int(raw.max()),
        saturated=float(image.saturated.mean()),
        underexposed=float(image.underexposed.mean()),
        dolp=_median(image.dolp),
        polarized=float(polarized.mean()),
        residual=_median(consistency_residual(front_end.channels(frame))),
        sigma_aolp=float(np.degrees(_median(image.sigma_aolp))),
        sigma_aolp_polarized=float(np.degrees(_median(image.sigma_aolp[polarized]))),
    )


def _median(values: np.ndarray) -> float:
    finite = values[np.isfinite(values)]
    return float(np.median(finite)) if finite.size else float("nan")


def frame_pictures(image: PolarizationImage) -> dict[str, np.ndarray]:
    """The pictures of one frame by name, each RGB uint8 H×W×3; the overview at most 1200 pixels wide.

    Brightness is scaled to the 99th percentile of the frame, DoLP to the 98th, at least 0.05.
    """
    white = max(float(np.percentile(image.intensity, 99)), 1e-3)
    full = float(np.clip(np.percentile(image.dolp, 98), POLARIZED, 1.0))
    panels = {
        "s0": pictures.grey(image.intensity, white),
        "dolp": pictures.dolp(image.dolp, full),
        "aolp": pictures.aolp(image.aolp),
        "polarization": pictures.polarization(image.aolp, image.dolp, full),
        "exposure": pictures.exposure(image.intensity, image.saturated, image.underexposed),
    }
    return {**panels, "overview": _overview(panels)}


def write_pictures(folder: Path, name: str, image: PolarizationImage) -> list[Path]:
    """Write `<name>_s0.png`, `_dolp`, `_aolp`, `_polarization`, `_exposure` and `<name>_overview.jpg`.

    Makes the folder. Returns the files' paths. Raises PolarmapError where they cannot be written.
    """
    folder, paths = Path(folder), []
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise PolarmapError(f"{folder}: cannot be made ({reason(error)})") from None
    for kind, picture in frame_pictures(image).items():
        paths.append(folder / f"{name}_{kind}.{'jpg' if kind == 'overview' else 'png'}")
        write_image(paths[-1], cv2.cvtColor(picture, cv2.COLOR_RGB2BGR))
    return paths


def _overview(panels: dict[str, np.ndarray]) -> np.ndarray:
    """S0, DoLP and AoLP side by side, with the colour wheel of the angles."""
    chosen = [panels[kind] for kind in ("s0", "dolp", "aolp")]
    height, width = chosen[0].shape[:2]
    scale = min(1.0, OVERVIEW_WIDTH / (3 * width))
    size = max(1, int(width * scale)), max(1, int(height * scale))
    chosen = [cv2.resize(picture, size, interpolation=cv2.INTER_AREA) for picture in chosen]
    wheel = pictures.aolp_wheel(max(8, int(_WHEEL_SHARE * size[1])))
    corner = chosen[2][-wheel.shape[0] :, -wheel.shape[1] :]
    wheel = wheel[: corner.shape[0], : corner.shape[1]]
    np.copyto(corner, wheel, where=wheel.any(axis=-1, keepdims=True))
    return pictures.montage(chosen, gap=0)


def inspection_table(inspection: Inspection) -> Table:
    """The inspection as a table for the terminal, one row a frame."""
    table = Table(title=_title(inspection), caption=_CAPTION)
    table.add_column("frame")
    for heading in (
        "values",
        "saturated",
        "dark",
        "DoLP",
        "DoLP > 0.05",
        "residual",
        "σ AoLP",
        "σ where > 0.05",
    ):
        table.add_column(heading, justify="right")
    for frame in inspection.frames:
        table.add_row(
            frame.name,
            f"{frame.lowest}-{frame.highest}",
            f"{frame.saturated:.2%}",
            f"{frame.underexposed:.2%}",
            f"{frame.dolp:.3f}",
            f"{frame.polarized:.0%}",
            f"{frame.residual:.1%}",
            f"{frame.sigma_aolp:.1f}°",
            f"{frame.sigma_aolp_polarized:.1f}°",
        )
    return table


_CAPTION = (
    "DoLP, residual and σ are medians. Residual: |(I0+I90)-(I45+I135)| / S0, 0 for an ideal sensor. "
    "σ: standard deviation of the angle by sensor noise."
)


def _title(inspection: Inspection) -> str:
    count = f"{inspection.frame_count} frame" + ("s" if inspection.frame_count != 1 else "")
    time = "" if np.isnan(inspection.rate) else f", {inspection.duration:.2f} s, {inspection.rate:.3g}/s"
    size = f"{inspection.width}x{inspection.height}, {inspection.bit_depth} bit"
    return f"{inspection.path}: {count}{time}, {size}, {inspection.demosaic}, {inspection.angle_direction}"
