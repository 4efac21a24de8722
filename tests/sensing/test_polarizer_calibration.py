"""Calibration of polarizers: what was put into simulated pictures is found, and makes measurements better."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from polarizer_pictures import TRUTH, behind_polarizer, frame, mosaic_of

from polarmap.data.camera_file import CameraFile
from polarmap.data.sensor import AngleDirection, SensorLayout, SensorNoise
from polarmap.errors import InputError
from polarmap.geometry.camera import PinholeCamera
from polarmap.sensing.calibration import calibrate_sensor
from polarmap.sensing.front_end import FrontEnd

CAMERA = PinholeCamera(96, 96, 90.0, 90.0, 47.5, 47.5)
CLOCKWISE, COUNTERCLOCKWISE = AngleDirection.CLOCKWISE, AngleDirection.COUNTERCLOCKWISE
ANGLES = (3.0, 31.0, 52.0, 77.0, 101.0, 124.0, 149.0, 168.0)


def camera_file(bit_depth=12, direction=COUNTERCLOCKWISE, black=0.0, **changes):
    noise = SensorNoise(10_000.0, 2.5)
    return CameraFile(
        CAMERA, SensorLayout.SONY_POLARSENS, direction, bit_depth, black_level=black, noise=noise, **changes
    )


class Bench:
    """Pictures of a camera with these polarizers, whose black level is 40 whatever its file says."""

    def __init__(self, file, truth=TRUTH, seed=1, black=40.0):
        self.file, self.truth, self.rng, self.black = file, truth, np.random.default_rng(seed), black

    def shot(self, stokes, name="picture", shade=0.3):
        return frame(mosaic_of(self.file, self.truth, np.asarray(stokes), self.rng, self.black, shade), name)

    def dark(self, count=3):
        return [self.shot([0.0, 0.0, 0.0], f"dark{i}") for i in range(count)]

    def flat(self, count=2, light=1.2):
        return [self.shot([light, 0.0, 0.0], f"flat{i}") for i in range(count)]

    def turned(self, angles=ANGLES, light=0.8):
        """The lamp is polarized itself, so that the light behind the polarizer changes as it turns."""
        lamp = [light * (1 + 0.1 * np.cos(np.radians(2 * angle))) for angle in angles]
        return [self.shot(behind_polarizer(self.file, angle, lamp[i]), f"turned{i}") for i, angle in enumerate(angles)]


def deviations(result, truth=TRUTH):
    """Errors in standard errors, 3×4."""
    found = result.fit.calibration
    errors = [np.subtract(getattr(found, name), getattr(truth, name)) for name in ("angles", "gains", "efficiencies")]
    return np.stack(errors) / result.fit.errors


HOW = {
    "known angles": {"angles": ANGLES},
    "known angles, absolute": {"angles": ANGLES, "absolute": True},
    "known to a common offset": {"angles": [angle + 33.0 for angle in ANGLES]},
    "unknown angles": {},
}


@pytest.mark.parametrize("how", HOW.values(), ids=HOW)
@pytest.mark.parametrize("direction", AngleDirection)
@pytest.mark.parametrize("bit_depth", [8, 12])
def test_the_truth_is_found_within_its_standard_errors(how, direction, bit_depth):
    bench = Bench(camera_file(bit_depth, direction), black=6.0 if bit_depth == 8 else 40.0)
    result = calibrate_sensor(bench.file, bench.dark(), bench.flat(), bench.turned(), **how)
    assert np.abs(deviations(result)).max() < 4.0
    assert result.fit.errors[0].max() < 0.1  # degrees
    assert result.fit.errors[1:].max() < 0.002
    assert result.left_out == ()
    assert result.camera_file.black_level == pytest.approx(bench.black, abs=4 * result.black_error + 0.01)
    assert result.camera_file.polarizers == result.fit.calibration


@pytest.mark.parametrize("how", HOW.values(), ids=HOW)
def test_standard_errors_are_neither_too_large_nor_too_small(how):
    """Over 24 calibrations the rms of error over standard error is near 1; the parts of a mean are not independent."""
    squares = []
    for seed in range(24):
        bench = Bench(camera_file(), seed=seed)
        result = calibrate_sensor(bench.file, bench.dark(), bench.flat(), bench.turned(), **how)
        squares.append(deviations(result) ** 2)
    assert 0.7 < np.sqrt(np.mean(squares)) < 1.4


def test_unknown_angles_come_out():
    bench = Bench(camera_file())
    fit = calibrate_sensor(bench.file, bench.dark(), bench.flat(), bench.turned()).fit
    away = (np.array(fit.polarizer_angles) - ANGLES + 90) % 180 - 90
    assert np.abs(away).max() < 0.1
    assert fit.names == tuple(f"turned{i}.png" for i in range(8))


def test_known_angles_need_no_flat_field():
    bench = Bench(camera_file())
    result = calibrate_sensor(bench.file, bench.dark(), [], bench.turned(), angles=ANGLES)
    assert np.abs(deviations(result)).max() < 4.0


def test_only_black_and_gains():
    bench = Bench(camera_file())
    black = calibrate_sensor(bench.file, bench.dark())
    assert black.fit is None and black.camera_file.polarizers is None
    assert black.camera_file.black_level == pytest.approx(40.0, abs=0.1)
    gains = calibrate_sensor(black.camera_file, flat=bench.flat(3))
    np.testing.assert_allclose(gains.fit.calibration.gains, TRUTH.gains, atol=5e-4)
    assert gains.fit.calibration.angles == pytest.approx((0, 45, 90, 135))
    assert any("only gains" in note for note in gains.notes)


def test_wrong_settings_of_the_mount_become_larger_standard_errors():
    """Angles read off to half a degree: what noise does not explain is seen, and the truth stays within the errors."""
    bench = Bench(camera_file())
    wrong = np.array(ANGLES) + np.random.default_rng(3).normal(0, 0.5, len(ANGLES))
    exact = calibrate_sensor(bench.file, bench.dark(), bench.flat(), bench.turned(), angles=ANGLES)
    result = calibrate_sensor(bench.file, bench.dark(), bench.flat(), bench.turned(), angles=wrong)
    assert result.fit.scatter > 10 * max(exact.fit.scatter, 1e-4)
    assert result.fit.errors[0].mean() > 5 * exact.fit.errors[0].mean()
    assert np.abs(deviations(result)).max() < 4.0


def test_a_picture_that_contradicts_all_others_is_left_out_and_named():
    bench = Bench(camera_file())
    angles = np.arange(5.0, 180.0, 15.0)
    turned = bench.turned(angles)
    stokes = behind_polarizer(bench.file, angles[3]) * [1.0, 0.7, 0.7]  # the polarizer did not cover the lens
    turned[3] = bench.shot(stokes, "turned3")
    result = calibrate_sensor(bench.file, bench.dark(), bench.flat(), turned)
    assert result.left_out == ("turned3.png",)
    assert np.abs(deviations(result)).max() < 4.0


def test_a_colour_sensor_is_calibrated_on_what_all_its_colours_see():
    """Pixels of the Bayer colours differ by more than a factor of two, which is neither noise nor dust."""
    bench = Bench(camera_file(colour="RGGB"))
    bayer = np.kron(np.tile([[0.5, 1.0], [1.0, 0.4]], (48, 48)), np.ones((2, 2)))
    grey = bench.shot

    def shot(stokes, name="picture", shade=0.3):
        raw = grey(stokes, name, shade).mosaic
        return frame(np.round((raw - bench.black) * bayer + bench.black).clip(0).astype(np.uint16), name)

    bench.shot = shot
    result = calibrate_sensor(bench.file, bench.dark(), bench.flat(), bench.turned())
    assert np.abs(deviations(result)).max() < 4.0
    assert result.fit.errors[0].max() < 0.1


def test_dust_does_not_count():
    bench = Bench(camera_file())
    flat = bench.flat(1)
    flat[0].mosaic[90:110, 90:110] = 60
    clean = calibrate_sensor(bench.file, bench.dark(), flat, bench.turned())
    assert np.abs(deviations(clean)).max() < 4.0


def refused(bench, words, dark=None, flat=None, turned=None, **how):
    parts = [bench.dark() if dark is None else dark, bench.flat() if flat is None else flat]
    with pytest.raises(InputError) as error:
        calibrate_sensor(bench.file, *parts, bench.turned() if turned is None else turned, **how)
    assert words in str(error.value)


def test_what_does_not_determine_it_is_refused_with_what_to_do():
    bench = Bench(camera_file())
    refused(bench, "nothing to calibrate with", [], [], [])
    refused(bench, "take 6 or more", turned=bench.turned((0, 40, 80, 120, 160)))
    refused(bench, "take 4 or more", turned=bench.turned((0, 60, 120)), angles=(0, 60, 120))
    refused(bench, "take 5 or more", flat=[], turned=bench.turned((0, 40, 80, 120)), angles=(0, 40, 80, 120))
    refused(bench, "at 2 different angles", turned=bench.turned((0, 0, 90, 90, 90.5)))
    refused(bench, "lie within 40 degrees", turned=bench.turned((0, 10, 20, 30, 40)), angles=(0, 10, 20, 30, 40))
    refused(bench, "without a flat field", flat=[])
    refused(bench, "7 angles for 8 pictures", angles=ANGLES[:7])
    refused(bench, "--absolute is for known angles", absolute=True)


def test_pictures_that_cannot_be_used_are_named():
    bench = Bench(camera_file())
    refused(bench, "turned0.png: ", turned=bench.turned(light=1.4))
    refused(bench, "is saturated; expose it shorter", turned=bench.turned(light=1.4))
    refused(bench, "flat0.png: 1", flat=bench.flat(light=0.02))
    refused(bench, "is too dark; expose it longer", flat=bench.flat(light=0.02))
    refused(bench, "put the lens cap on", dark=bench.flat())
    refused(bench, "so that its light is polarized", flat=[bench.shot([1.0, 0.3, 0.0], "flat0")])
    refused(bench, "the polarizer has to cover the lens", turned=bench.flat(8))


def test_pictures_of_things_are_no_flat_fields():
    bench = Bench(camera_file())
    y, x = np.mgrid[0:96, 0:96]
    things = 0.6 + 0.5 * np.sin(x / 9) * np.sin(y / 11)
    refused(bench, "darker); picture white paper", flat=[bench.shot([things, 0 * things, 0 * things])])
    sheen = 0.2 * np.sin(x / 9)
    refused(bench, "its channels' shares vary by", flat=[bench.shot([1 + 0 * sheen, sheen, 0 * sheen])])


def test_uneven_light_makes_larger_standard_errors():
    """A slight sheen on one side, which pixels' noise does not show."""
    bench = Bench(camera_file())
    ramp = np.linspace(-0.03, 0.03, 96)[None].repeat(96, 0)
    even = calibrate_sensor(bench.file, bench.dark(), bench.flat(1)).fit.errors[1]
    uneven = calibrate_sensor(bench.file, bench.dark(), [bench.shot([1.2 + 0 * ramp, ramp, -ramp])]).fit.errors[1]
    assert uneven.min() > 3 * even.max()


def test_angles_in_the_wrong_sense_or_order_are_told():
    bench = Bench(camera_file())
    refused(bench, "give them with the other sign", angles=[-angle for angle in ANGLES])
    swapped = [*ANGLES[:2], ANGLES[3], ANGLES[2], *ANGLES[4:]]
    refused(bench, "do not agree with the pictures; turned", angles=swapped)


def test_light_that_changes_against_malus_is_refused():
    bench = Bench(camera_file())
    rng = np.random.default_rng(5)
    turned = [
        bench.shot(behind_polarizer(bench.file, angle) * [1, rng.uniform(0.7, 1), rng.uniform(0.7, 1)], f"turned{i}")
        for i, angle in enumerate(np.arange(0.0, 180.0, 15.0))
    ]
    refused(bench, "off the law of Malus", turned=turned)


@pytest.mark.parametrize("how", [{"angles": ANGLES[:7:2]}, {"angles": ANGLES[:5], "flat": []}, {}], ids=str)
def test_the_fewest_pictures_do(how):
    bench = Bench(camera_file())
    flat = how.pop("flat", None)
    angles = how.get("angles", ANGLES[:6])
    result = calibrate_sensor(
        bench.file, bench.dark(), bench.flat() if flat is None else flat, bench.turned(angles), **how
    )
    assert np.abs(deviations(result)).max() < 4.0
    assert result.fit.spare in (1, 2)


@pytest.mark.parametrize("direction", AngleDirection)
@pytest.mark.parametrize("demosaic", ["split", "bilinear", "edge-aware"])
def test_a_calibrated_camera_measures_better(direction, demosaic):
    bench = Bench(camera_file(direction=direction))
    calibrated = calibrate_sensor(bench.file, bench.dark(), bench.flat(), bench.turned()).camera_file
    calibrated = replace(calibrated, demosaic=demosaic)
    lights = [(dolp, aolp) for dolp in (0.1, 0.4, 0.9) for aolp in np.radians(np.arange(5.0, 180.0, 25.0))]
    shots = [bench.shot([1.0, dolp * np.cos(2 * aolp), dolp * np.sin(2 * aolp)], shade=0.0) for dolp, aolp in lights]

    def errors(file):
        """Rms over the lights of the mean picture's errors: DoLP, AoLP in degrees, intensity."""
        front_end, found = FrontEnd(file), []
        for shot, (dolp, aolp) in zip(shots, lights, strict=True):
            image = front_end.polarization(shot)
            away = (image.aolp - aolp + np.pi / 2) % np.pi - np.pi / 2
            found.append([image.dolp.mean() - dolp, np.degrees(away.mean()), image.intensity.mean() - 0.5])
        return np.sqrt(np.mean(np.square(found), axis=0))

    before, after = errors(replace(calibrated, polarizers=None)), errors(calibrated)
    assert before[0] > 0.01 and before[1] > 0.5 and before[2] > 0.001
    assert np.all(after < 0.1 * before)
