"""The simulated sensor: every layout tells the same, noise is what it says, and the seed decides it."""

from __future__ import annotations

import numpy as np
import pytest

from polarmap.data.sensor import AngleDirection, SensorLayout, SensorNoise
from polarmap.errors import InputError
from polarmap.geometry.pose import look_at
from polarmap.synth import Sensor
from polarmap.synth.shutter import shutter_poses

STOKES = np.random.default_rng(0).uniform([[[0.6]], [[-0.3]], [[-0.3]]], [[[1.2]], [[0.3]], [[0.3]]], (3, 6, 8))
STOKES = STOKES.astype(np.float32)


def decoded(mosaic: np.ndarray, sensor: Sensor) -> np.ndarray:
    """Stokes vectors of the 2×2 blocks, by the definition of a polarizer, least squares over the four angles."""
    turn = 1.0 if sensor.angle_direction is AngleDirection.CLOCKWISE else -1.0
    alpha = turn * np.radians(sensor.layout.value)
    rows = 0.5 * np.stack([np.ones(4), np.cos(2 * alpha), np.sin(2 * alpha)], axis=1)
    pixels = np.stack([mosaic[r::2, c::2] for r in (0, 1) for c in (0, 1)]) / (2**sensor.bit_depth - 1)
    return np.tensordot(np.linalg.pinv(rows), pixels, axes=1)


@pytest.mark.parametrize("direction", list(AngleDirection))
@pytest.mark.parametrize("layout", list(SensorLayout))
def test_every_layout_and_direction_decodes_to_the_same_stokes_vectors(layout, direction):
    sensor = Sensor(layout, direction, bit_depth=16, noise=None)
    np.testing.assert_allclose(decoded(sensor.capture(STOKES), sensor), STOKES, atol=4e-5)


def test_the_sony_layout_places_its_angles():
    stokes = np.array([1.0, 0.4, 0.2], np.float32).reshape(3, 1, 1)
    mosaic = Sensor(bit_depth=16, noise=None).capture(stokes) / 65535
    np.testing.assert_allclose(mosaic, [[0.3, 0.6], [0.4, 0.7]], atol=1e-5)  # 90 45 / 135 0


@pytest.mark.parametrize(("bits", "kind"), [(8, np.uint8), (10, np.uint16), (12, np.uint16), (16, np.uint16)])
def test_bit_depth_sets_steps_and_white(bits, kind):
    stokes = np.zeros((3, 1, 2), np.float32)
    stokes[0] = 1.0, 7.0
    mosaic = Sensor(bit_depth=bits, noise=None).capture(stokes)
    assert mosaic.dtype == kind
    assert mosaic[0, 0] == round(0.5 * (2**bits - 1))
    assert mosaic[0, 3] == 2**bits - 1


def test_exposure_scales_the_intensity():
    mosaic = Sensor(bit_depth=16, noise=None, exposure=0.25).capture(
        np.ones((3, 2, 2), np.float32) * [[[1]], [[0]], [[0]]]
    )
    np.testing.assert_array_equal(mosaic, round(0.125 * 65535))


@pytest.mark.parametrize("s0", [0.0, 0.1, 1.0])
def test_noise_has_the_variance_of_shot_and_read_noise(s0):
    stokes = np.zeros((3, 200, 200), np.float32)
    stokes[0] = s0
    noise = SensorNoise(full_well=2000.0, read_noise=10.0)
    values = Sensor(bit_depth=16, noise=noise, exposure=1.0).capture(stokes) / 65535
    variance = s0 / 2 / 2000.0 + (10.0 / 2000.0) ** 2
    if s0 == 0.0:  # clipped at black: the positive half of the distribution remains
        assert values.mean() == pytest.approx(np.sqrt(variance / (2 * np.pi)), rel=0.02)
    else:
        assert values.mean() == pytest.approx(s0 / 2, abs=4 * np.sqrt(variance / values.size))
        assert values.var() == pytest.approx(variance, rel=0.02)


def test_the_seed_and_the_frame_decide_the_noise():
    first = Sensor(seed=1).capture(STOKES, frame_index=3)
    np.testing.assert_array_equal(first, Sensor(seed=1).capture(STOKES, frame_index=3))
    assert (first != Sensor(seed=1).capture(STOKES, frame_index=4)).any()
    assert (first != Sensor(seed=2).capture(STOKES, frame_index=3)).any()


def test_with_sub_pixels_each_polarizer_sees_its_own_point():
    sensor = Sensor(noise=None, bit_depth=16, sub_pixel=True)
    mosaic = sensor.capture(STOKES)
    assert mosaic.shape == (6, 8)
    s0, s1, s2 = STOKES
    np.testing.assert_allclose(mosaic[0::2, 1::2] / 65535, 0.5 * (s0 + s2)[0::2, 1::2], atol=2e-5)  # 45
    np.testing.assert_allclose(mosaic[1::2, 1::2] / 65535, 0.5 * (s0 + s1)[1::2, 1::2], atol=2e-5)  # 0


def test_impossible_sensors_are_refused():
    with pytest.raises(InputError, match="bit_depth"):
        Sensor(bit_depth=17)
    with pytest.raises(InputError, match="exposure"):
        Sensor(exposure=0.0)
    with pytest.raises(InputError, match="2x2"):
        Sensor(sub_pixel=True).capture(STOKES[:, :5])


def test_a_leaking_polarizer_passes_the_crossed_direction_by_its_extinction_ratio():
    stokes = np.array([1.0, 1.0, 0.0], np.float32).reshape(3, 1, 1)  # all light along 0 degrees
    sensor = Sensor(bit_depth=16, noise=None, extinction_ratio=20.0)
    mosaic = sensor.capture(stokes) / 65535
    np.testing.assert_allclose(mosaic, [[0.05, 0.525], [0.525, 1.0]], atol=1e-5)  # 90 45 / 135 0
    s0, s1, _ = decoded(sensor.capture(stokes), sensor)
    assert s1.item() / s0.item() == pytest.approx((1 - 1 / 20) / (1 + 1 / 20), abs=1e-4)


@pytest.mark.parametrize(
    ("wrong", "word"),
    [
        ({"extinction_ratio": 1.0}, "extinction_ratio"),
        ({"extinction_ratio": float("nan")}, "extinction_ratio"),
        ({"shutter": 1.5}, "shutter"),
        ({"seed": -1}, "seed"),
        ({"noise": SensorNoise(full_well=0.0)}, "full_well"),
        ({"noise": SensorNoise(read_noise=-1.0)}, "read_noise"),
    ],
)
def test_sensors_out_of_range_are_refused(wrong, word):
    with pytest.raises(InputError, match=word):
        Sensor(**wrong)


def test_the_shutter_is_centred_on_the_frame_and_follows_the_path():
    poses = np.stack([np.eye(4)] * 3)
    poses[:, 0, 3] = 0.0, 1.0, 3.0
    x = shutter_poses(poses, 1, 0.5, 4)[:, 0, 3]
    np.testing.assert_allclose(x, 1.0 + np.array([-0.1875, -0.0625, 0.125, 0.375]))  # slower before than after
    np.testing.assert_allclose(shutter_poses(poses, 0, 1.0, 2)[:, 0, 3], [-0.25, 0.25])
    np.testing.assert_allclose(shutter_poses(poses, 2, 1.0, 2)[:, 0, 3], [2.5, 3.5])
    np.testing.assert_array_equal(shutter_poses(poses, 1, 0.5, 1), poses[1:2])
    np.testing.assert_array_equal(shutter_poses(poses[:1], 0, 1.0, 3), poses[[0, 0, 0]])


def test_a_turning_camera_turns_evenly_while_the_shutter_is_open():
    turns = np.stack([look_at((0, 0, 0), (np.sin(a), np.cos(a), 0)) for a in (0.0, 0.2)])
    open_at = shutter_poses(turns, 0, 1.0, 2)
    angles = np.arctan2(open_at[:, 0, 2], open_at[:, 1, 2])
    np.testing.assert_allclose(angles, [-0.05, 0.05], atol=1e-12)
