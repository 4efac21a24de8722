"""Raw buffers: known bytes from the formats' tables, round trips, wrong sizes."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from polarmap.data.pixel_format import PixelFormat
from polarmap.errors import InputError
from polarmap.io.formats.packed import pack, unpack

# Four pixels and their bytes, worked out by hand from the tables in Basler's and PFNC's documents.
PIXELS_12 = [[0xABC, 0x123], [0x000, 0xFFF]]
PIXELS_10 = [[0x2AB, 0x13C], [0x000, 0x3FF]]
GOLDEN = [
    (PixelFormat.MONO12_PACKED, PIXELS_12, "ab3c12 00f0ff"),
    (PixelFormat.MONO12P, PIXELS_12, "bc3a12 00f0ff"),
    (PixelFormat.MONO10_PACKED, PIXELS_10, "aa034f 0030ff"),
    (PixelFormat.MONO10P, PIXELS_10, "abf204c0ff"),
    (PixelFormat.MONO12, PIXELS_12, "bc0a 2301 0000 ff0f"),
    (PixelFormat.MONO8, [[1, 2], [3, 255]], "010203ff"),
]


@pytest.mark.parametrize(("pixel_format", "pixels", "data"), GOLDEN)
def test_known_bytes(pixel_format, pixels, data):
    data = bytes.fromhex(data)
    image = unpack(data, pixel_format, (2, 2))
    np.testing.assert_array_equal(image, pixels)
    assert image.dtype == (np.uint8 if pixel_format is PixelFormat.MONO8 else np.uint16)
    assert pack(np.array(pixels), pixel_format) == data


@settings(max_examples=60, deadline=None)
@given(st.sampled_from(list(PixelFormat)), st.integers(1, 9), st.integers(1, 9), st.integers(0, 2**32 - 1))
def test_round_trip(pixel_format, height, width, seed):
    shape = (2 * height, 2 * width)
    image = np.random.default_rng(seed).integers(0, 1 << pixel_format.bits, shape)
    data = pack(image, pixel_format)
    assert len(data) == pixel_format.byte_count(shape)
    np.testing.assert_array_equal(unpack(data, pixel_format, shape), image)


@pytest.mark.parametrize("change", [-1, 1])
def test_a_buffer_of_the_wrong_size_is_named(change):
    data = bytes(12 + change)
    with pytest.raises(InputError, match=r"1[13] bytes, but 4x2 pixels of Mono12Packed take 12"):
        unpack(data, PixelFormat.MONO12_PACKED, (2, 4))


def test_pixels_that_do_not_fill_a_group_of_bytes_are_refused():
    with pytest.raises(InputError, match="3x2 pixels are no multiple of 4"):
        unpack(bytes(8), PixelFormat.MONO10P, (2, 3))


def test_values_beyond_the_format_are_refused():
    with pytest.raises(InputError, match=r"\[0, 1023\]"):
        pack(np.full((2, 2), 1024), PixelFormat.MONO10_PACKED)


def test_an_unknown_format_lists_the_known_ones():
    with pytest.raises(InputError, match="'Mono14' is not known; write one of Mono8, Mono10,"):
        PixelFormat.from_name("Mono14")
