"""What a calibration found, as tables for the terminal."""

from __future__ import annotations

from rich.table import Table

from polarmap.data.polarizers import LABELS
from polarmap.sensing.calibration import PolarizerFit, SensorCalibration


def channel_table(fit: PolarizerFit) -> Table:
    """One row a channel: angle, gain and efficiency with their standard errors."""
    table = Table("channel", title="polarizers", caption="± standard errors")
    for heading in ("angle", "gain", "efficiency"):
        table.add_column(heading, justify="right")
    for k, label in enumerate(LABELS):
        angle, gain, efficiency = fit.values[:, k]
        errors = fit.errors[:, k]
        table.add_row(
            str(label),
            f"{angle:.2f}° ± {errors[0]:.2f}" if errors[0] else "not fitted",
            f"{gain:.4f} ± {errors[1]:.4f}",
            f"{efficiency:.4f} ± {errors[2]:.4f}" if errors[2] else "not fitted",
        )
    return table


def picture_table(fit: PolarizerFit) -> Table:
    """One row a picture: the polarizer's angle, and how far its channels are from the fit."""
    angles = dict(zip(fit.names, fit.polarizer_angles, strict=True))
    table = Table("picture", title="pictures")
    table.add_column("polarizer", justify="right")
    table.add_column("residual", justify="right")
    for name, residual in zip(fit.all_names, fit.residuals, strict=True):
        table.add_row(name, f"{angles[name]:.2f}°" if name in angles else "none", f"{residual:.3%}")
    return table


def told_calibration(result: SensorCalibration) -> list[str]:
    """The rest of it in lines."""
    lines = []
    if result.black_error is not None:
        lines.append(f"black level {result.camera_file.black_level:.3f} ± {result.black_error:.3f}")
    if result.fit is not None:
        unexplained = f"{result.fit.scatter:.3%} of brightness" if result.fit.scatter else "nothing"
        tried = f"; measurements left to try the law of Malus by: {result.fit.spare}" if result.fit.names else ""
        lines.append(f"beyond noise: {unexplained}{tried}")
    if result.left_out:
        lines.append(f"left out, as they contradict all others: {', '.join(result.left_out)}")
    return [*lines, *result.notes]
