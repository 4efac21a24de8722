"""Demosaicing against plain NumPy references, and against full-resolution truth at edges."""

from __future__ import annotations

import numpy as np
import pytest

from polarmap.data.sensor import AngleDirection, SensorLayout
from polarmap.errors import InputError
from polarmap.sensing.mosaic import (
    METHODS,
    channel_offsets,
    colour_to_grey,
    demosaic,
    mean_of_split_light,
    noise_gain,
    split,
    split_light,
)
from polarmap.sensing.stokes import mean_intensity

SONY = SensorLayout.SONY_POLARSENS
CLOCKWISE, COUNTERCLOCKWISE = AngleDirection.CLOCKWISE, AngleDirection.COUNTERCLOCKWISE
ANGLES = np.radians([0.0, 45.0, 90.0, 135.0])


def block_mean(image):
    height, width = image.shape[-2:]
    return image.reshape(*image.shape[:-2], height // 2, 2, width // 2, 2).mean(axis=(-3, -1))


def random_mosaic(height=24, width=32, seed=0):
    return np.random.default_rng(seed).uniform(0.1, 0.9, (height, width)).astype(np.float32)


def mosaic_of(channels, layout=SONY):
    mosaic = np.empty(channels.shape[1:], np.float32)
    for channel, (y, x) in zip(channels, channel_offsets(layout, CLOCKWISE), strict=True):
        mosaic[y::2, x::2] = channel[y::2, x::2]
    return mosaic


def interpolated(mosaic, layout=SONY):
    """Each angle's pixels interpolated to all pixels: a tent over the neighbours that are there."""
    height, width = mosaic.shape
    out = np.zeros((4, height, width))
    for k, (oy, ox) in enumerate(channel_offsets(layout, CLOCKWISE)):
        for y in range(height):
            for x in range(width):
                rows = [r for r in (y - 1, y, y + 1) if 0 <= r < height and r % 2 == oy]
                columns = [c for c in (x - 1, x, x + 1) if 0 <= c < width and c % 2 == ox]
                out[k, y, x] = np.mean([mosaic[r, c] for r in rows for c in columns])
    return out


@pytest.mark.parametrize("layout", SensorLayout)
def test_each_channel_is_taken_from_the_pixel_with_its_label(layout):
    labels = np.tile(np.reshape(layout.value, (2, 2)), (3, 4))
    np.testing.assert_array_equal(split(labels, layout)[:, 1, 2], [0, 45, 90, 135])
    np.testing.assert_array_equal(split(labels, layout, COUNTERCLOCKWISE)[:, 1, 2], [0, 135, 90, 45])


@pytest.mark.parametrize("layout", [SONY, SensorLayout.LAYOUT_0_135_45_90])
def test_bilinear_is_the_tent_over_equal_angles(layout):
    mosaic = random_mosaic(10, 14)
    full = demosaic(mosaic, layout, "bilinear", full_resolution=True)
    np.testing.assert_allclose(full, interpolated(mosaic, layout), atol=1e-6)


@pytest.mark.parametrize("method", ["bilinear", "edge-aware"])
@pytest.mark.parametrize("direction", AngleDirection)
def test_half_resolution_is_the_block_mean_of_full_resolution(method, direction):
    mosaic = random_mosaic()
    full = demosaic(mosaic, SONY, method, direction, full_resolution=True)
    np.testing.assert_allclose(demosaic(mosaic, SONY, method, direction), block_mean(full), atol=1e-6)


@pytest.mark.parametrize("layout", SensorLayout)
def test_bilinear_registers_a_ramp_to_block_centres(layout):
    y, x = np.mgrid[:16, :20]
    ramps = np.stack([0.1 * k + 0.01 * x - 0.005 * y for k in range(1, 5)]).astype(np.float32)
    inner = np.s_[:, 1:-1, 1:-1]
    registered = demosaic(mosaic_of(ramps, layout), layout, "bilinear")
    np.testing.assert_allclose(registered[inner], block_mean(ramps)[inner], atol=1e-6)
    unregistered = demosaic(mosaic_of(ramps, layout), layout, "split")
    assert np.abs(unregistered - block_mean(ramps))[inner].min() > 0.002


def edge_aware_reference(mosaic):
    """The equations of the method in double precision, one pixel after the other."""
    m = mosaic.astype(float)
    height, width = m.shape
    rough, guide, slope = np.zeros_like(m), np.zeros_like(m), np.zeros_like(m)
    for y, x in np.ndindex(m.shape):
        y0, x0 = np.clip(y - 1, 0, height - 3), np.clip(x - 1, 0, width - 3)
        rough[y, x] = abs(m[y, x0 + 2] - m[y, x0]) + abs(m[y0 + 2, x] - m[y0, x])
    for y, x in np.ndindex(m.shape):
        windows = [np.s_[i : i + 2, j : j + 2] for i in (y - 1, y) for j in (x - 1, x)
                   if 0 <= i <= height - 2 and 0 <= j <= width - 2]  # fmt: skip
        weights = [(rough[w].mean() + 0.02 * m[w].mean() + 1e-4) ** -2 for w in windows]
        guide[y, x] = np.average([m[w].mean() for w in windows], weights=weights)
    for y, x in np.ndindex(m.shape):
        yc = y + 2 * (y < 2) - 2 * (y >= height - 2)
        xc = x + 2 * (x < 2) - 2 * (x >= width - 2)
        g, v = guide[yc - 2 : yc + 3 : 2, xc - 2 : xc + 3 : 2], m[yc - 2 : yc + 3 : 2, xc - 2 : xc + 3 : 2]
        prior = 0.05**2 * g.mean()
        covariance = (g * v).mean() - g.mean() * v.mean()
        slope[y, x] = (covariance + prior * v.mean()) / (g.var() + prior * g.mean() + 1e-8)
    return interpolated(slope) * guide + interpolated(m - slope * guide)


def test_edge_aware_follows_its_equations():
    mosaic = random_mosaic(12, 14, seed=3)
    full = demosaic(mosaic, SONY, "edge-aware", full_resolution=True)
    np.testing.assert_allclose(full, edge_aware_reference(mosaic), atol=2e-4)


def test_edge_aware_keeps_what_was_measured_and_flat_channels():
    mosaic = random_mosaic(seed=1)
    full = demosaic(mosaic, SONY, "edge-aware", full_resolution=True)
    np.testing.assert_allclose(mosaic_of(full), mosaic, atol=1e-5)
    flat = np.array([0.2, 0.4, 0.5, 0.3], np.float32)[:, None, None] * np.ones((4, 12, 12), np.float32)
    np.testing.assert_allclose(demosaic(mosaic_of(flat), SONY, "edge-aware"), flat[:, ::2, ::2], atol=1e-6)


def test_edge_aware_works_alike_at_any_exposure_and_survives_black():
    mosaic = random_mosaic(seed=2)
    bright, dim = demosaic(mosaic, SONY, "edge-aware"), demosaic(mosaic * 0.25, SONY, "edge-aware")
    np.testing.assert_allclose(dim * 4, bright, atol=0.02)
    assert not demosaic(np.zeros((8, 8), np.float32), SONY, "edge-aware").any()


def full_resolution_scene(size=192, oversampling=4):
    """Stokes image 3×H×W, anti-aliased: slanted steps and shaded discs, each with its own DoLP and AoLP."""
    fine = (np.mgrid[: size * oversampling, : size * oversampling] + 0.5) / oversampling
    y, x = fine.astype(np.float32)
    intensity, dolp, aolp = (np.full_like(x, v) for v in (0.35, 0.03, 0.4))
    regions = [(y > 0.31 * x + 110, 0.6, 0.15, 1.2), (y < 45 - 0.5 * x, 0.12, 0.3, 2.5)]
    for cx, cy, radius, brightness in [(60, 60, 32, 0.7), (140, 110, 34, 0.15), (150, 40, 24, 0.5)]:
        r = np.hypot(x - cx, y - cy) / radius
        regions.append((r < 1, brightness, 0.5 * np.minimum(r, 1) ** 2, np.arctan2(y - cy, x - cx)))
    for inside, *values in regions:
        for field, value in zip((intensity, dolp, aolp), values, strict=True):
            np.copyto(field, value, where=inside)
    stokes = 2 * intensity * np.stack([np.ones_like(x), dolp * np.cos(2 * aolp), dolp * np.sin(2 * aolp)])
    return stokes.reshape(3, size, oversampling, size, oversampling).mean(axis=(2, 4))


def dolp_of(channels):
    return np.hypot(channels[0] - channels[2], channels[1] - channels[3]) / (0.5 * channels.sum(axis=0))


def test_edge_aware_lowers_the_dolp_error_at_edges():
    stokes = full_resolution_scene()
    cos2, sin2 = np.cos(2 * ANGLES)[:, None, None], np.sin(2 * ANGLES)[:, None, None]
    mosaic = mosaic_of(0.5 * (stokes[0] + stokes[1] * cos2 + stokes[2] * sin2))
    mosaic += np.random.default_rng(0).normal(0, 0.004, mosaic.shape)
    s0, s1, s2 = block_mean(stokes)
    truth = np.hypot(s1, s2) / s0
    step = np.hypot(*np.gradient(s0)) > 0.05
    edges = np.logical_or.reduce([np.roll(step, (i, j), (0, 1)) for i in (-2, 0, 2) for j in (-2, 0, 2)])
    split_error, bilinear_error, edge_aware_error = (
        np.abs(dolp_of(demosaic(mosaic, SONY, method)) - truth)[edges].mean() for method in METHODS
    )
    assert bilinear_error < 0.7 * split_error
    assert edge_aware_error < 0.6 * bilinear_error


def test_noise_gain_is_that_of_a_flat_noisy_mosaic():
    mosaic = (0.5 + 0.01 * np.random.default_rng(0).standard_normal((480, 640))).astype(np.float32)
    for method in METHODS:
        channels = demosaic(mosaic, SONY, method)
        measured = np.var(channels[0] - channels[2]) / 2e-4
        assert measured <= 1.03 * noise_gain(method)
        if method != "edge-aware":
            assert measured == pytest.approx(noise_gain(method), rel=0.03)
        grey = demosaic(colour_to_grey(mosaic), SONY, method)
        assert np.var(grey[1] - grey[3]) / 2e-4 <= 1.05 * noise_gain(method, colour=True)


@pytest.mark.parametrize("pattern", ["RGGB", "BGGR", "GRBG", "GBRG"])
def test_colour_gives_the_same_luminance_under_any_bayer_pattern(pattern):
    light = {"R": (0.1, 0.2, 0.3, 0.4), "G": (0.3, 0.5, 0.2, 0.6), "B": (0.7, 0.1, 0.4, 0.2)}
    colours = np.tile(np.reshape(list(pattern), (2, 2)), (3, 4))
    channels = np.array([[[light[c][k] for c in row] for row in colours] for k in range(4)], np.float32)
    mosaic = mosaic_of(channels.repeat(2, axis=1).repeat(2, axis=2))
    luminance = [0.25 * light["R"][k] + 0.5 * light["G"][k] + 0.25 * light["B"][k] for k in range(4)]
    for method in METHODS:
        grey = demosaic(colour_to_grey(mosaic), SONY, method)
        np.testing.assert_allclose(grey, np.array(luminance)[:, None, None] * np.ones((1, 6, 8)), atol=1e-6)


@pytest.mark.parametrize(
    ("shape", "method", "full", "message"),
    [
        ((8, 8), "nearest", False, "split, bilinear, edge-aware"),
        ((8, 7), "split", False, "7x8 does not split"),
        ((0, 8), "bilinear", False, "does not split"),
        ((4, 8, 8), "split", False, "does not split"),
        ((8, 8), "split", True, "no full resolution"),
        ((4, 8), "edge-aware", False, "too small"),
    ],
)
def test_unusable_mosaics_are_refused(shape, method, full, message):
    with pytest.raises(InputError, match=message):
        demosaic(np.zeros(shape, np.float32), SONY, method, full_resolution=full)


def test_a_colour_mosaic_needs_whole_superpixels():
    with pytest.raises(InputError, match="4x4"):
        colour_to_grey(np.zeros((8, 10), np.float32))


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("direction", [CLOCKWISE, COUNTERCLOCKWISE])
@pytest.mark.parametrize("layout", SensorLayout)
def test_raw_values_become_split_light_and_its_mean_in_one_pass(layout, direction, dtype):
    """To the last bit what NumPy makes of them in several; black as much as white."""
    raw = np.random.default_rng(0).integers(0, np.iinfo(dtype).max, (18, 26), endpoint=True).astype(dtype)
    raw[:4, :4] = 3
    black, scale = np.float32(11.0), np.float32(1.0) / np.float32(np.iinfo(dtype).max - 11)
    expected = split((raw.astype(np.float32) - black) * scale, layout, direction)
    light = split_light(raw, layout, direction, black, scale)
    assert light.dtype == np.float32
    np.testing.assert_array_equal(light, expected)
    mean = mean_of_split_light(raw, layout, direction, black, scale)
    np.testing.assert_array_equal(mean, mean_intensity(expected))
    assert (mean[:2, :2] == 0.0).all() and mean.max() > 0.0
