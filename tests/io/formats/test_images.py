"""Image files: whole ones read back, anything else refused with a reason, never half-filled."""

from __future__ import annotations

import struct
import zlib
from contextlib import suppress

import cv2
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from polarmap.errors import InputError, PolarmapError
from polarmap.io.formats.images import read_header, read_image, read_picture, write_image

RNG = np.random.default_rng(7)
GREY8 = np.cumsum(RNG.integers(0, 3, (48, 64)), axis=1).astype(np.uint8)
GREY16 = GREY8.astype(np.uint16) * 401
TIFF_PLAIN, TIFF_LZW, TIFF_DEFLATE = ([cv2.IMWRITE_TIFF_COMPRESSION, code] for code in (1, 5, 8))
FILES = {
    "8-bit png": (".png", GREY8, []),
    "16-bit png": (".png", GREY16, []),
    "16-bit tiff": (".tif", GREY16, TIFF_PLAIN),
    "8-bit lzw tiff": (".tif", GREY8, TIFF_LZW),
    "16-bit deflate tiff": (".tiff", GREY16, TIFF_DEFLATE),
    "16-bit pgm": (".pgm", GREY16, []),
    "8-bit pgm": (".pgm", GREY8, []),
    "8-bit bmp": (".bmp", GREY8, []),
}
# Formats whose pixels carry no checksum: a changed byte shows as a changed pixel.
CHECKED = ["8-bit png", "16-bit png"]


def encoded(name: str) -> bytes:
    suffix, image, parameters = FILES[name]
    return cv2.imencode(suffix, image, parameters)[1].tobytes()


@pytest.mark.parametrize("name", FILES)
def test_whole_files_are_read(tmp_path, name):
    (tmp_path / "a").write_bytes(encoded(name))
    image = read_image(tmp_path / "a")
    assert image.dtype == FILES[name][1].dtype
    np.testing.assert_array_equal(image, FILES[name][1])


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.sampled_from(list(FILES)), st.floats(0, 1, exclude_max=True))
def test_a_truncated_file_is_never_half_filled(tmp_path, name, share):
    data = encoded(name)
    (tmp_path / "a").write_bytes(data[: int(share * len(data))])
    if "tiff" in name and share > 0.9:  # what is lost may be a tag after the pixels
        with suppress(InputError):
            np.testing.assert_array_equal(read_image(tmp_path / "a"), FILES[name][1])
        return
    with pytest.raises(InputError, match=r"truncated or corrupt|not a PNG"):
        read_image(tmp_path / "a")


@settings(max_examples=100, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.sampled_from(CHECKED), st.floats(0, 1, exclude_max=True), st.integers(1, 255))
def test_a_changed_byte_is_noticed_where_there_are_checksums(tmp_path, name, share, change):
    data = bytearray(encoded(name))
    data[int(share * len(data))] ^= change
    (tmp_path / "a").write_bytes(data)
    with pytest.raises(InputError):
        read_image(tmp_path / "a")


@settings(max_examples=200, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.sampled_from(list(FILES)), st.integers(0, 200), st.binary(min_size=1, max_size=8))
def test_a_changed_header_gives_an_image_or_an_input_error(tmp_path, name, position, change):
    data = bytearray(encoded(name))
    data[position : position + len(change)] = change
    (tmp_path / "a").write_bytes(data)
    try:
        image = read_image(tmp_path / "a")
    except InputError as error:
        assert "\n" not in str(error)
    else:
        assert image.ndim == 2 and image.dtype in (np.uint8, np.uint16)


def test_a_tiff_whose_strip_is_absent_is_refused(tmp_path):
    data = encoded("16-bit tiff")
    byte_count = data.index(struct.pack("<HHI", 279, 4, 1)) + 8
    (tmp_path / "a").write_bytes(data[:byte_count] + bytes(4) + data[byte_count + 4 :])
    with pytest.raises(InputError, match="truncated or corrupt"):
        read_image(tmp_path / "a")


def png(width: int, height: int, body: bytes) -> bytes:
    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    header = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(body)) + chunk(b"IEND", b"")


def test_sound_checksums_around_too_few_pixels(tmp_path):
    rows = b"".join(b"\0" + row.tobytes() for row in GREY8)
    (tmp_path / "a").write_bytes(png(64, 48, rows))
    np.testing.assert_array_equal(read_image(tmp_path / "a"), GREY8)
    (tmp_path / "a").write_bytes(png(64, 48, rows[: len(rows) // 2]))
    with pytest.raises(InputError, match="truncated or corrupt"):
        read_image(tmp_path / "a")


def test_a_header_that_claims_a_huge_image_takes_no_memory(tmp_path):
    (tmp_path / "a").write_bytes(png(2**31 - 1, 2**31 - 1, b""))
    with pytest.raises(InputError, match="2147483647x2147483647 pixels is no usable image size"):
        read_image(tmp_path / "a")


def test_size_and_depth_other_than_expected(tmp_path):
    (tmp_path / "a.png").write_bytes(encoded("8-bit png"))
    with pytest.raises(InputError, match=r"a\.png: 64x48 pixels, expected 48x64"):
        read_image(tmp_path / "a.png", size=(48, 64))
    with pytest.raises(InputError, match=r"a\.png: 8 bits per pixel, expected 16"):
        read_image(tmp_path / "a.png", bits=16)
    assert read_header(tmp_path / "a.png").width == 64


@pytest.mark.parametrize("suffix", [".png", ".tif", ".bmp"])
def test_colour_images_are_refused(tmp_path, suffix):
    write_image(tmp_path / f"a{suffix}", np.dstack([GREY8, GREY8 // 2, GREY8]))
    with pytest.raises(InputError, match=r"not a plain grey image|a colour image"):
        read_image(tmp_path / f"a{suffix}")


def test_jpeg_is_refused_with_the_reason(tmp_path):
    (tmp_path / "a.jpg").write_bytes(cv2.imencode(".jpg", GREY8)[1].tobytes())
    with pytest.raises(InputError, match="JPEG compression destroys polarization"):
        read_image(tmp_path / "a.jpg")


def test_pgm_with_comments_and_a_smaller_white_level_keeps_its_values(tmp_path):
    values = np.arange(8, dtype=">u2").reshape(2, 4)
    (tmp_path / "a.pgm").write_bytes(b"P5\n# a comment\n4 2\n4095\n" + values.tobytes())
    np.testing.assert_array_equal(read_image(tmp_path / "a.pgm"), values)


def test_what_is_no_image_or_no_file(tmp_path):
    (tmp_path / "a.png").write_text("hello")
    with pytest.raises(InputError, match="not a PNG, TIFF"):
        read_image(tmp_path / "a.png")
    with pytest.raises(InputError, match="no such file"):
        read_image(tmp_path / "b.png")


def test_write_and_read(tmp_path):
    write_image(tmp_path / "a.png", GREY16)
    np.testing.assert_array_equal(read_image(tmp_path / "a.png"), GREY16)
    with pytest.raises(InputError, match="cannot be written in this format"):
        write_image(tmp_path / "a.xyz", GREY16)
    with pytest.raises(PolarmapError, match="cannot be written"):
        write_image(tmp_path / "none" / "a.png", GREY16)
    assert [path.name for path in tmp_path.iterdir()] == ["a.png"]


COLOUR = np.dstack([GREY8, GREY8[::-1], 255 - GREY8])
LUMA = COLOUR @ [0.114, 0.587, 0.299]  # BGR
PICTURES = {
    "colour jpeg": (".jpg", COLOUR, LUMA, 12.0),
    "progressive jpeg": (".jpg", COLOUR, LUMA, 12.0),
    "grey jpeg": (".jpg", GREY8, GREY8, 12.0),
    "colour png": (".png", COLOUR, LUMA, 1.0),
    "16-bit colour png": (".png", COLOUR.astype(np.uint16) * 257, LUMA * 257, 257.0),
    "png with alpha": (".png", np.dstack([COLOUR, GREY8]), LUMA, 1.0),
    "grey png": (".png", GREY16, GREY16, 0.0),
}


def picture(name: str) -> bytes:
    suffix, image = PICTURES[name][:2]
    options = [cv2.IMWRITE_JPEG_PROGRESSIVE, 1] if "progressive" in name else []
    return cv2.imencode(suffix, image, options)[1].tobytes()


@pytest.mark.parametrize("name", PICTURES)
def test_pictures_are_read_as_luma(tmp_path, name):
    (tmp_path / "a").write_bytes(picture(name))
    _, image, luma, tolerance = PICTURES[name]
    found = read_picture(tmp_path / "a", size=(64, 48), bits=8 * image.itemsize)
    assert found.dtype == image.dtype
    np.testing.assert_allclose(found.astype(float), luma, atol=tolerance)


@settings(max_examples=100, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.sampled_from(list(PICTURES)), st.floats(0, 1, exclude_max=True))
def test_a_truncated_picture_is_never_half_filled(tmp_path, name, share):
    data = picture(name)
    (tmp_path / "a").write_bytes(data[: int(share * len(data))])
    with pytest.raises(InputError, match=r"truncated or corrupt|not a PNG"):
        read_picture(tmp_path / "a")


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.sampled_from(list(PICTURES)), st.integers(0, 700), st.binary(min_size=1, max_size=8))
def test_a_changed_picture_header_gives_an_image_or_an_input_error(tmp_path, name, position, change):
    data = bytearray(picture(name))
    data[position : position + len(change)] = change
    (tmp_path / "a").write_bytes(data)
    with suppress(InputError):
        image = read_picture(tmp_path / "a")
        assert image.ndim == 2 and image.dtype in (np.uint8, np.uint16)


def test_a_picture_of_another_depth(tmp_path):
    (tmp_path / "a.jpg").write_bytes(picture("colour jpeg"))
    with pytest.raises(InputError, match=r"a\.jpg: 8 bits per pixel, expected 16"):
        read_picture(tmp_path / "a.jpg", bits=16)


def several_pages(reduced: bool) -> bytes:
    """A TIFF of two pages, the second of them marked as a preview or not."""
    data = bytearray(cv2.imencodemulti(".tif", [GREY8, GREY8 // 2], TIFF_PLAIN)[1].tobytes())
    (first,) = struct.unpack_from("<I", data, 4)
    (entries,) = struct.unpack_from("<H", data, first)
    (second,) = struct.unpack_from("<I", data, first + 2 + 12 * entries)
    (entries,) = struct.unpack_from("<H", data, second)
    kinds = {struct.unpack_from("<H", data, second + 2 + 12 * i)[0]: second + 2 + 12 * i for i in range(entries)}
    place = kinds.get(254, second + 2)  # else its first tag, the width, which nobody reads, becomes the kind
    struct.pack_into("<HHII", data, place, 254, 4, 1, 1 if reduced else 2)
    return bytes(data)


def animated_png() -> bytes:
    data = encoded("8-bit png")
    body = b"acTL" + struct.pack(">II", 2, 0)
    return data[:33] + struct.pack(">I", 8) + body + struct.pack(">I", zlib.crc32(body)) + data[33:]


@pytest.mark.parametrize(
    "data",
    [several_pages(reduced=False), animated_png(), 2 * encoded("8-bit pgm")],
    ids=["tiff", "png", "pgm"],
)
def test_a_file_of_several_pictures_is_refused(tmp_path, data):
    (tmp_path / "a").write_bytes(data)
    with pytest.raises(InputError, match="a: holds more than one picture; write each frame to a file of its own"):
        read_image(tmp_path / "a")


def test_a_preview_in_a_tiff_is_no_second_picture(tmp_path):
    (tmp_path / "a").write_bytes(several_pages(reduced=True))
    np.testing.assert_array_equal(read_image(tmp_path / "a"), GREY8)


def test_pages_in_a_circle_are_refused(tmp_path):
    data = bytearray(several_pages(reduced=True))
    (first,) = struct.unpack_from("<I", data, 4)
    (entries,) = struct.unpack_from("<H", data, first)
    (second,) = struct.unpack_from("<I", data, first + 2 + 12 * entries)
    (more,) = struct.unpack_from("<H", data, second)
    struct.pack_into("<I", data, second + 2 + 12 * more, second)
    (tmp_path / "a").write_bytes(data)
    with pytest.raises(InputError, match="holds more than one picture"):
        read_image(tmp_path / "a")
