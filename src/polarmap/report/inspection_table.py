"""What a recorded sequence holds, as a table for the terminal."""

from __future__ import annotations

import numpy as np
from rich.table import Table

from polarmap.report.inspection import Inspection


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
