"""Mosaics from a real Sony IMX250MZR: what they must measure, and which way its polarizer angles turn."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, map_coordinates

from polarmap.data.camera_file import CameraFile
from polarmap.data.sensor import AngleDirection, SensorLayout
from polarmap.geometry.camera import PinholeCamera
from polarmap.io.recording.sequence import open_sequence
from polarmap.report.inspection import inspect_sequence
from polarmap.sensing.front_end import FrontEnd

APPLE = (369.0, 314.0)  # centre in the 1224x1024 image, found by eye
JUST_INSIDE_ITS_OUTLINE = (240.0, 252.0, 264.0)  # pixels; the outline is at 273 to 290


def open_mosaic(shared_data, name, direction, method="split"):
    path = shared_data / "raw_imx250mzr" / f"{name}_IMX250MZR.png"
    if not path.is_file():
        pytest.skip(f"{path.name} is not on this machine")
    camera = PinholeCamera(1224, 1024, 1900.0, 1900.0, 611.5, 511.5)
    return open_sequence(path, CameraFile(camera, SensorLayout.SONY_POLARSENS, direction, 8, demosaic=method))


def double_angle_on_a_circle(shared_data, direction, radius):
    """2φ, radians, of light from the apple at each degree of polar angle, clockwise from image +x."""
    sequence = open_mosaic(shared_data, "fruits", direction)
    i0, i45, i90, i135 = FrontEnd(sequence.camera_file).channels(sequence[0])
    beta = np.radians(np.arange(360))
    places = APPLE[1] + radius * np.sin(beta), APPLE[0] + radius * np.cos(beta)
    s1, s2 = (map_coordinates(gaussian_filter(s, 4), places, order=1) for s in (i0 - i90, i45 - i135))
    return np.arctan2(s2, s1)


def turns(angle):
    steps = np.diff(angle, append=angle[0])
    return np.round(((steps + np.pi) % (2 * np.pi) - np.pi).sum() / (2 * np.pi), 6)


@pytest.mark.parametrize("radius", JUST_INSIDE_ITS_OUTLINE)
def test_only_counterclockwise_angles_turn_with_the_apples_outline(shared_data, radius):
    """AoLP must turn as the surface normal does, which turns with the polar angle; here by π once round."""
    assert turns(double_angle_on_a_circle(shared_data, AngleDirection.COUNTERCLOCKWISE, radius)) == 1
    assert turns(double_angle_on_a_circle(shared_data, AngleDirection.CLOCKWISE, radius)) == -1


def test_below_the_apple_reflects_and_is_polarized_along_its_outline(shared_data):
    lower = np.arange(20, 161)
    tangent = np.radians(lower + 90)

    def deviation(direction):
        double_angle = double_angle_on_a_circle(shared_data, direction, radius=250.0)[lower]
        return np.degrees(np.abs((double_angle - 2 * tangent + np.pi) % (2 * np.pi) - np.pi) / 2)

    right, wrong = (deviation(d) for d in (AngleDirection.COUNTERCLOCKWISE, AngleDirection.CLOCKWISE))
    assert np.median(right) < 8
    assert right.max() < 20
    assert np.median(wrong) > 30


@pytest.mark.parametrize(
    ("name", "dolp", "clipped"), [("carps", 0.536, 0.10), ("fruits", 0.080, 0.0), ("polarizer", 0.054, 0.15)]
)
def test_what_an_inspection_finds(shared_data, tmp_path, name, dolp, clipped):
    sequence = open_mosaic(shared_data, name, AngleDirection.COUNTERCLOCKWISE)
    (frame,) = inspect_sequence(sequence, pictures_to=tmp_path).frames
    assert 0.02 < frame.residual < 0.03
    assert frame.dolp == pytest.approx(dolp, abs=0.002)
    assert frame.saturated == pytest.approx(clipped, abs=0.005)
    assert 0.3 < frame.sigma_aolp_polarized < 6
    assert (tmp_path / f"{name}_IMX250MZR_overview.jpg").stat().st_size < 400_000


def test_interpolation_removes_false_polarization_at_edges(shared_data):
    """The houses behind the polarizer sheets are hardly polarized; split makes their edges look so."""
    houses = np.s_[270:440, 640:900]
    strongest_dolp = {}
    for method in ("split", "bilinear", "edge-aware"):
        sequence = open_mosaic(shared_data, "polarizer", AngleDirection.COUNTERCLOCKWISE, method)
        strongest_dolp[method] = np.percentile(
            FrontEnd(sequence.camera_file).polarization(sequence[0]).dolp[houses], 90
        )
    assert strongest_dolp["bilinear"] < 0.8 * strongest_dolp["split"]
    assert strongest_dolp["edge-aware"] < strongest_dolp["bilinear"]
