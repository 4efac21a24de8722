"""Inspection of recorded sequences, and the colour pictures it draws."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from rich.console import Console
from scenes import WIDE, view_of

from polarmap.data.camera_file import CameraFile
from polarmap.data.sensor import AngleDirection, SensorLayout
from polarmap.errors import InputError, PolarmapError
from polarmap.geometry.camera import PinholeCamera
from polarmap.geometry.surface import incidence_direction
from polarmap.io.recording.camera_file import write_camera_file
from polarmap.io.recording.sequence import open_sequence
from polarmap.report import pictures
from polarmap.report.inspection import inspect_sequence
from polarmap.report.inspection_table import inspection_table
from polarmap.synth import Sensor
from polarmap.synth.scene_recording import record_scene

CAMERA = PinholeCamera(40, 30, 40.0, 40.0, 19.5, 14.5)
ANGLES = np.radians([[90, 45], [135, 0]])


def write_sequence(folder, count=7, dolp=0.3):
    """Uniform light of intensity 0.4 with AoLP 30°, the first 10 columns of blocks clipped, 2 rows black."""
    mosaic = np.tile(0.4 * (1 + dolp * np.cos(2 * (ANGLES - np.radians(30)))), (30, 40))
    mosaic[:, :20], mosaic[:4, 20:] = 1.0, 0.0
    (folder / "raw").mkdir(parents=True)
    for i in range(count):
        cv2.imwrite(str(folder / "raw" / f"{i:06d}.png"), np.round(255 * mosaic).astype(np.uint8))
    layout, direction = SensorLayout.SONY_POLARSENS, AngleDirection.CLOCKWISE
    write_camera_file(folder / "camera.yaml", CameraFile(CAMERA, layout, direction, 8, frame_rate=20.0))
    return open_sequence(folder)


def test_inspection_measures_what_was_recorded(tmp_path):
    inspection = inspect_sequence(write_sequence(tmp_path / "seq"), samples=3)
    assert (inspection.frame_count, inspection.width, inspection.height) == (7, 40, 30)
    assert inspection.duration == pytest.approx(6 / 20)
    assert inspection.rate == pytest.approx(20)
    assert [frame.name for frame in inspection.frames] == ["000000", "000003", "000006"]
    frame = inspection.frames[0]
    assert (frame.lowest, frame.highest) == (0, 255)
    assert frame.saturated == pytest.approx(0.25)
    assert frame.underexposed == pytest.approx(0.75 * 2 / 30)
    assert frame.polarized == pytest.approx(0.75 * 28 / 30)
    assert frame.dolp == pytest.approx(0.3, abs=0.01)
    assert frame.residual < 0.005
    assert frame.sigma_aolp_polarized <= frame.sigma_aolp < 2


def test_an_inspection_draws_pictures_that_show_it(tmp_path):
    inspect_sequence(write_sequence(tmp_path / "seq", count=1), pictures_to=tmp_path / "out")
    names = sorted(path.name for path in (tmp_path / "out").iterdir())
    kinds = ["aolp.png", "dolp.png", "exposure.png", "overview.jpg", "polarization.png", "polarnormal.png", "s0.png"]
    assert names == [f"000000_{kind}" for kind in kinds]
    exposure = cv2.imread(str(tmp_path / "out" / "000000_exposure.png"))[..., ::-1]
    assert tuple(exposure[20, 5]) == pictures.SATURATED
    assert tuple(exposure[0, 30]) == pictures.UNDEREXPOSED
    red, green, blue = cv2.imread(str(tmp_path / "out" / "000000_aolp.png"))[20, 30, ::-1].astype(int)
    assert red > 250  # 30° is yellow
    assert green > 230
    assert blue < 5


def test_pictures_of_normals_agree_with_a_sphere_up_to_what_one_picture_tells(tmp_path):
    """Red is right, green up, blue toward the camera; what faces downward looks as if it faced upward."""
    record_scene(tmp_path / "seq", "sphere", 1, WIDE, Sensor(bit_depth=12), supersample=1)
    sequence = open_sequence(tmp_path / "seq")
    inspect_sequence(sequence, pictures_to=tmp_path / "out")
    picture = cv2.imread(str(tmp_path / "out" / "000000_polarnormal.png"))[..., ::-1].astype(int)
    truth = view_of("sphere", "matte")
    direction = incidence_direction(truth.normal, WIDE)
    known = (picture != pictures.MISSING).any(axis=-1) & (np.linalg.norm(direction, axis=-1) > 0.3)
    assert (picture[~np.isfinite(truth.depth)] == pictures.MISSING).mean() > 0.9
    rays = WIDE.rays()
    mirrored = 2.0 * np.einsum("hwc,hwc->hw", truth.normal, rays)[..., None] * rays - truth.normal
    off, off_mirrored = (np.abs(picture - pictures.normals(n).astype(int)).max(-1) for n in (truth.normal, mirrored))
    upward, downward = known & (direction[..., 1] < -0.1), known & (direction[..., 1] > 0.1)
    assert upward.sum() > 100 and downward.sum() > 100
    assert np.median(off[upward]) < 12 and np.median(off_mirrored[upward]) > 40
    assert np.median(off[downward]) > 40 and np.median(off_mirrored[downward]) < 12


def test_an_inspection_prints_as_a_table(tmp_path):
    console = Console(width=250)
    with console.capture() as capture:
        console.print(inspection_table(inspect_sequence(write_sequence(tmp_path / "seq", count=2))))
    text = " ".join(capture.get().split())
    for expected in ("2 frames", "40x30, 8 bit", "000001", "25.00%", "0.30"):
        assert expected in text


def test_a_sequence_without_times_or_polarization_can_be_inspected(tmp_path):
    sequence = write_sequence(tmp_path / "seq", count=1, dolp=0.0)
    inspection = inspect_sequence(sequence)
    assert np.isnan(inspection.rate)
    assert np.isnan(inspection.frames[0].sigma_aolp_polarized)
    assert "1 frame," in inspection_table(inspection).title


def test_an_empty_sequence_and_an_unwritable_folder_are_reported(tmp_path):
    sequence = write_sequence(tmp_path / "seq", count=1)
    with pytest.raises(InputError, match="no frames"):
        inspect_sequence(sequence[:0])
    (tmp_path / "taken").write_text("")
    with pytest.raises(PolarmapError, match="taken"):
        inspect_sequence(sequence, pictures_to=tmp_path / "taken")


def test_depth_pictures_share_a_range_and_mark_what_is_missing():
    z = np.array([[1.0, 2.0, np.nan, 4.0]], np.float32)
    picture = pictures.depth(z, limits=(1.0, 4.0))
    assert picture.shape == (1, 4, 3)
    assert picture.dtype == np.uint8
    assert tuple(picture[0, 2]) == pictures.MISSING
    assert picture[0, 0, 0] > picture[0, 0, 2]  # near is red
    assert picture[0, 3, 2] > picture[0, 3, 0]  # far is blue
    np.testing.assert_array_equal(pictures.depth(z[:, 1:2], limits=(1.0, 4.0))[0, 0], picture[0, 1])
    assert (pictures.depth(np.full((2, 2), np.nan, np.float32)) == pictures.MISSING).all()
    assert pictures.depth_limits(np.full((2, 2), 3.0)) == pytest.approx((2.97, 3.03))


def test_normals_toward_the_camera_are_blue_and_upward_ones_green():
    normal = np.array([[[0, 0, -1], [0, -1, 0], [np.nan, np.nan, np.nan]]], np.float32)
    np.testing.assert_allclose(pictures.normals(normal)[0], [(127, 127, 255), (127, 255, 127), pictures.MISSING])


def test_aolp_colours_have_period_pi_and_agree_with_the_wheel():
    angle = np.array([[0.0, np.pi / 3, 2 * np.pi / 3, np.pi - 1e-6]], np.float32)
    picture = pictures.aolp(angle).astype(int)
    np.testing.assert_allclose(picture[0], [(255, 0, 0), (0, 255, 0), (0, 0, 255), (255, 0, 0)], atol=6)
    wheel = pictures.aolp_wheel(101).astype(int)
    for direction in (np.pi / 3, np.pi / 3 - np.pi):  # down right, and opposite
        x, y = (np.rint(50 + 40 * f(direction)).astype(int) for f in (np.cos, np.sin))
        np.testing.assert_allclose(wheel[y, x], (0, 255, 0), atol=12)
    assert not pictures.polarization(angle, np.zeros_like(angle)).any()
    np.testing.assert_array_equal(pictures.polarization(angle, angle * 0 + 0.7, full=0.5), pictures.aolp(angle))


def test_codes_shares_and_greys_have_their_colours():
    codes = np.array([[0, 1, 2, 3]], np.uint8)
    np.testing.assert_array_equal(pictures.labels(codes)[0], pictures.LABEL_COLOURS)
    np.testing.assert_array_equal(pictures.origins(codes)[0], pictures.ORIGIN_COLOURS)
    shares = np.array([[0.0, 1.0, np.nan]], np.float32)
    for draw in (pictures.confidence, pictures.grey, lambda v: pictures.error(v, limit=0.5)):
        low, high, missing = draw(shares)[0].astype(int)
        assert high.sum() > low.sum()
        assert tuple(missing) == pictures.MISSING
    np.testing.assert_array_equal(pictures.error(-shares, 2.0), pictures.error(shares, 2.0))
    assert pictures.dolp(np.array([[0.6]]), full=0.5).sum() == pictures.dolp(np.array([[0.5]]), full=0.5).sum()


def test_a_montage_keeps_every_picture_whole():
    tiles = [np.full((4, 6, 3), 10 * k, np.uint8) for k in range(1, 4)]
    sheet = pictures.montage(tiles, columns=2, gap=1)
    assert sheet.shape == (9, 13, 3)
    for k, (top, left) in enumerate([(0, 0), (0, 7), (5, 0)], start=1):
        assert (sheet[top : top + 4, left : left + 6] == 10 * k).all()
    assert (sheet[5:, 7:] == 255).all()
