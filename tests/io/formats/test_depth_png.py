"""Depth in 16-bit PNG files."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from polarmap.errors import InputError
from polarmap.io.formats.depth_png import depth_png_scale, read_depth_png, write_depth_png
from polarmap.io.formats.images import write_image


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(arrays(np.float32, (5, 7), elements=st.floats(0, 13.0, width=32) | st.just(np.nan) | st.just(np.inf)))
def test_round_trip_to_half_a_step(tmp_path, depth):
    write_depth_png(tmp_path / "d.png", depth, 5000.0)
    back = read_depth_png(tmp_path / "d.png", 5000.0, size=(7, 5))
    known = np.isfinite(depth) & (depth > 0)
    assert back.dtype == np.float32
    np.testing.assert_array_equal(np.isfinite(back), known)
    # What is nearer than half a step is written as 1, for 0 means none.
    np.testing.assert_allclose(back[known], np.maximum(depth[known], 1 / 5000), atol=0.51 / 5000)


@given(st.floats(1e-6, 1e6))
def test_the_scale_is_the_largest_round_one_that_fits(max_depth):
    scale = depth_png_scale(max_depth)
    assert max_depth * scale <= 65535 < max_depth * scale * 2.5 * (1 + 1e-9)
    assert f"{scale:e}"[0] in "125"


def test_known_scales():
    assert [depth_png_scale(depth) for depth in (8.0, 13.107, 13.108, 70.0)] == [5000.0, 5000.0, 2000.0, 500.0]
    with pytest.raises(InputError, match="must be positive"):
        depth_png_scale(float("nan"))


def test_depth_beyond_16_bits_is_refused(tmp_path):
    with pytest.raises(InputError, match="14 does not fit 16 bits at scale 5000"):
        write_depth_png(tmp_path / "d.png", np.array([[1.0, 14.0]]), 5000.0)


def test_an_8_bit_picture_is_no_depth(tmp_path):
    write_image(tmp_path / "d.png", np.zeros((2, 2), np.uint8))
    with pytest.raises(InputError, match="8 bits per pixel, expected 16"):
        read_depth_png(tmp_path / "d.png", 5000.0)
