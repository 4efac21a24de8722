"""Image files, decoded whole or refused: grey PNG, TIFF, PGM and BMP of 8 or 16 bits; also JPEG and colour PNG.

Decoders fill what a truncated file lacks and take memory for whatever size a header claims. Here the header
is read and the file's structure checked first (in PNG every chunk's checksum); OpenCV then decodes a file
that is known to be complete. JPEG has no checksums: only its end is looked for.

Polarization must come in grey files (`read_image`): colour conversion and JPEG destroy it. Other pictures may have
colours (`read_picture`).
"""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from polarmap.errors import InputError
from polarmap.io.files import MAX_IMAGE_BYTES, read_bytes, write_bytes

IMAGE_SUFFIXES = (".png", ".tif", ".tiff", ".pgm", ".bmp")
PICTURE_SUFFIXES = (*IMAGE_SUFFIXES, ".jpg", ".jpeg")
MAX_PIXELS = 1 << 26

_MOST_BYTES_A_PIXEL = 16  # of a file whose size is known: four samples of 16 bits, twice
_MOST_METADATA = 1 << 24  # bytes

_PNG = b"\x89PNG\r\n\x1a\n"
_JPEG = b"\xff\xd8"
_BIG_TIFF = (b"II+\0", b"MM\0+")
_TRUNCATED = "truncated or corrupt; copy or record the file again"
_SEVERAL = "holds more than one picture; write each frame to a file of its own"


@dataclass(frozen=True)
class ImageHeader:
    """What an image file says of itself: width and height in pixels, bits per sample (8 or 16), whether it is grey."""

    width: int
    height: int
    bits: int
    grey: bool = True


def read_image(path: Path, size: tuple[int, int] | None = None, bits: int | None = None) -> np.ndarray:
    """A grey image, uint8 or uint16 H×W.

    size, bits: the (width, height) and the bits per pixel that it must have, if any.
    Raises InputError where the file cannot be read, is of another format, size or depth, has colours, or is
    truncated or corrupt.
    """
    return _read(Path(path), _parse_header, size, bits)


def read_picture(path: Path, size: tuple[int, int] | None = None, bits: int | None = None) -> np.ndarray:
    """As `read_image`, but also of JPEG and colour PNG files, whose luma 0.299 R + 0.587 G + 0.114 B is returned.

    A rotation that a JPEG's EXIF data asks for is not done.
    """
    return _read(Path(path), _parse_picture_header, size, bits)


def read_colours(path: Path, most_pixels: int) -> np.ndarray:
    """A grey or colour picture in PNG, TIFF, PGM, BMP or JPEG of at most `most_pixels` pixels, BGR uint8 H×W×3.

    Raises InputError as `read_picture` does.
    """
    path = Path(path)
    data = read_bytes(path, _MOST_BYTES_A_PIXEL * most_pixels + _MOST_METADATA)
    try:
        header = _parse_picture_header(data)
        _check_expected(header, None, None)
        if header.width * header.height > most_pixels:
            raise InputError(f"{header.width}x{header.height} pixels, more than the {most_pixels} that are expected")
        picture = _decoded(lambda: cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR))
    except InputError as problem:
        raise InputError(f"{path}: {problem}") from None
    return picture


def read_header(path: Path) -> ImageHeader:
    """What a grey image file says of itself; InputError as for `read_image`."""
    data = read_bytes(Path(path))
    try:
        return _parse_header(data)
    except InputError as problem:
        raise InputError(f"{path}: {problem}") from None


def read_picture_header(path: Path) -> ImageHeader:
    """As `read_header`, but also of JPEG and colour PNG files."""
    data = read_bytes(Path(path))
    try:
        return _parse_picture_header(data)
    except InputError as problem:
        raise InputError(f"{path}: {problem}") from None


def write_image(path: Path, image: np.ndarray) -> None:
    """Write a grey (H×W) or BGR (H×W×3) image, uint8 or uint16, in the format of the suffix.

    Raises InputError where that format cannot hold it, PolarmapError where the file cannot be written.
    """
    path = Path(path)
    try:
        encoded, data = cv2.imencode(path.suffix, image)
    except cv2.error:
        encoded = False
    if not encoded:
        raise InputError(f"{path}: a {image.dtype} image {image.shape} cannot be written in this format")
    write_bytes(path, data.tobytes())


def decode_image(data: bytes, size: tuple[int, int] | None = None, bits: int | None = None) -> np.ndarray:
    """As `read_image`, of a file's bytes; messages name no file."""
    return _decoded_whole(data, _parse_header, size, bits)


def decode_picture(data: bytes, size: tuple[int, int] | None = None, bits: int | None = None) -> np.ndarray:
    """As `read_picture`, of a file's bytes; messages name no file."""
    return _decoded_whole(data, _parse_picture_header, size, bits)


def picture_header(data: bytes) -> ImageHeader:
    """As `read_picture_header`, of a file's bytes; messages name no file."""
    return _parse_picture_header(data)


def _read(
    path: Path, parse: Callable[[bytes], ImageHeader], size: tuple[int, int] | None, bits: int | None
) -> np.ndarray:
    data = read_bytes(path, _most_bytes(size))
    try:
        return _decoded_whole(data, parse, size, bits)
    except InputError as problem:
        raise InputError(f"{path}: {problem}") from None


def _decoded_whole(
    data: bytes, parse: Callable[[bytes], ImageHeader], size: tuple[int, int] | None, bits: int | None
) -> np.ndarray:
    header = parse(data)
    _check_expected(header, size, bits)
    return _decode(data, header)


def _most_bytes(size: tuple[int, int] | None) -> int:
    """Of a file of this (width, height), which may have colours and much metadata."""
    return MAX_IMAGE_BYTES if size is None else _MOST_BYTES_A_PIXEL * size[0] * size[1] + _MOST_METADATA


def _parse_header(data: bytes) -> ImageHeader:
    """The header of a complete grey image file's bytes; InputError (without the file's name) else."""
    for magic, parse in _PARSERS.items():
        if data.startswith(magic):
            return _parse_whole(parse, data)
    if data[:4] in _BIG_TIFF:
        raise InputError(
            "a BigTIFF file, which is not read; write a classic TIFF (under 4 GB, as all pictures are) or PNG"
        )
    if data.startswith(_JPEG):
        raise InputError("JPEG compression destroys polarization; record PNG, TIFF or raw files instead")
    raise InputError("not a PNG, TIFF, binary PGM or BMP image")


def _parse_picture_header(data: bytes) -> ImageHeader:
    """As `_parse_header`, of files that may have colours."""
    if data.startswith(_PNG):
        return _parse_whole(_parse_any_png, data)
    if data.startswith(_JPEG):
        return _parse_whole(_parse_jpeg, data)
    return _parse_header(data)


def _parse_whole(parse: Callable[[bytes], ImageHeader], data: bytes) -> ImageHeader:
    try:
        return parse(data)
    except (struct.error, OverflowError):
        raise InputError(_TRUNCATED) from None


def _check_expected(header: ImageHeader, size: tuple[int, int] | None, bits: int | None) -> None:
    found = (header.width, header.height)
    if size is not None and found != tuple(size):
        raise InputError(f"{found[0]}x{found[1]} pixels, expected {size[0]}x{size[1]}")
    if min(found) < 1 or found[0] * found[1] > MAX_PIXELS:
        raise InputError(f"{found[0]}x{found[1]} pixels is no usable image size")
    if bits is not None and header.bits != bits:
        raise InputError(f"{header.bits} bits per pixel, expected {bits}")


def _decode(data: bytes, header: ImageHeader) -> np.ndarray:
    image = _decoded(lambda: _decode_grey(np.frombuffer(data, np.uint8), header.grey))
    if image.shape != (header.height, header.width):
        raise InputError("a colour image; expected a grey one (the raw mosaic, or one picture per angle)")
    return image


def _decoded(decode: Callable[[], np.ndarray | None]) -> np.ndarray:
    """What OpenCV makes of a file's bytes; InputError where that is nothing."""
    try:
        with _quiet_opencv():
            image = decode()
    except cv2.error:
        image = None
    if image is None:
        raise InputError(_TRUNCATED)
    return image


def _decode_grey(data: np.ndarray, grey: bool) -> np.ndarray | None:
    if grey:
        return cv2.imdecode(data, cv2.IMREAD_UNCHANGED)
    if bytes(data[:2]) == _JPEG:  # its first channel is the luma
        return cv2.imdecode(data, cv2.IMREAD_GRAYSCALE | cv2.IMREAD_IGNORE_ORIENTATION)
    colour = cv2.imdecode(data, cv2.IMREAD_COLOR | cv2.IMREAD_ANYDEPTH | cv2.IMREAD_IGNORE_ORIENTATION)
    return None if colour is None else cv2.cvtColor(colour, cv2.COLOR_BGR2GRAY)


@contextmanager
def _quiet_opencv() -> Iterator[None]:
    """OpenCV reports what it cannot decode on stderr too; the exception says it once."""
    control = cv2 if hasattr(cv2, "setLogLevel") else cv2.utils.logging
    level = control.getLogLevel()
    control.setLogLevel(0)
    try:
        yield
    finally:
        control.setLogLevel(level)


def _parse_png(data: bytes) -> ImageHeader:
    header = _parse_any_png(data)
    return _grey_header(header.width, header.height, header.bits, header.grey)


def _parse_any_png(data: bytes) -> ImageHeader:
    width, height, bits, colour = struct.unpack_from(">IIBB", data, 16)
    position, kind, chunks = 8, b"", 0
    while kind != b"IEND":
        chunks += 1
        if chunks > _MOST_CHUNKS:
            raise InputError(_TRUNCATED)
        length, kind = struct.unpack_from(">I4s", data, position)
        body = memoryview(data)[position + 4 : position + 8 + length]
        (checksum,) = struct.unpack_from(">I", data, position + 8 + length)
        if zlib.crc32(body) != checksum:
            raise InputError(_TRUNCATED)
        if kind == b"acTL":  # an animation (APNG)
            raise InputError(_SEVERAL)
        position += 12 + length
    palette = colour == 3  # indexes of any size into 8-bit colours
    return ImageHeader(width, height, 8 if palette else bits, grey=colour == 0)


def _parse_jpeg(data: bytes) -> ImageHeader:
    """The frame header of a JPEG file (ITU-T T.81, annex B) whose end-of-image marker is there."""
    header, position, marker = None, 2, 0
    while marker != _START_OF_SCAN:
        first, marker, length = struct.unpack_from(">BBH", data, position)
        if first != 0xFF or length < 2:
            raise InputError(_TRUNCATED)
        if marker == 0xFF:  # a fill byte
            position += 1
            continue
        if marker in _START_OF_FRAME:
            bits, height, width, components = struct.unpack_from(">BHHB", data, position + 4)
            header = ImageHeader(width, height, bits, grey=components == 1)
        position += 2 + length
    many = data.count(_SCAN_MARKER, position) > _MOST_SCANS  # each is decoded over the whole picture
    if header is None or many or data.find(b"\xff\xd9", position) < 0:
        raise InputError(_TRUNCATED)
    return header


_MOST_CHUNKS = 1 << 17
_MOST_SCANS = 256
_SCAN_MARKER = b"\xff\xda"
_START_OF_SCAN = 0xDA
_START_OF_FRAME = {*range(0xC0, 0xD0)} - {0xC4, 0xC8, 0xCC}


def _parse_tiff(data: bytes) -> ImageHeader:
    order = "<" if data[:2] == b"II" else ">"
    tags = _tiff_tags(data, order)
    _require_one_page(data, order)
    try:
        (width,), (height,) = tags[_WIDTH], tags[_HEIGHT]
        offsets, counts, blocks = _tiff_blocks(tags, width, height)
    except (KeyError, ValueError, ZeroDivisionError):
        raise InputError(_TRUNCATED) from None
    complete = len(offsets) == len(counts) >= blocks and all(
        offset > 0 and 0 < count <= len(data) - offset for offset, count in zip(offsets, counts, strict=True)
    )
    grey = tags.get(_PHOTOMETRIC) == (1,) and tags.get(_SAMPLES, (1,)) == (1,)
    unsigned = tags.get(_SAMPLE_FORMAT, (1,)) == (1,)
    header = _grey_header(width, height, tags.get(_BITS, (1,))[0], grey and unsigned)
    stored = sum(counts) if tags.get(_COMPRESSION, (1,)) == (1,) else None
    if not complete or (stored is not None and stored < width * height * header.bits // 8):
        raise InputError(_TRUNCATED)
    return header


# TIFF 6.0 tags, and the struct codes of its unsigned integer types
_WIDTH, _HEIGHT, _BITS, _COMPRESSION, _PHOTOMETRIC = 256, 257, 258, 259, 262
_STRIP_OFFSETS, _SAMPLES, _STRIP_ROWS, _STRIP_COUNTS = 273, 277, 278, 279
_TILE_WIDTH, _TILE_HEIGHT, _TILE_OFFSETS, _TILE_COUNTS, _SAMPLE_FORMAT = 322, 323, 324, 325, 339
_TIFF_TAGS = {
    _WIDTH, _HEIGHT, _BITS, _COMPRESSION, _PHOTOMETRIC, _STRIP_OFFSETS, _SAMPLES, _STRIP_ROWS, _STRIP_COUNTS,
    _TILE_WIDTH, _TILE_HEIGHT, _TILE_OFFSETS, _TILE_COUNTS, _SAMPLE_FORMAT,
}  # fmt: skip
_TIFF_TYPES = {1: "B", 3: "H", 4: "I"}
_SUBFILE_TYPE = 254
_MOST_PAGES = 16  # previews of all sizes are fewer
_TIFF_SIZES = np.array([0, 1, 1, 2, 4, 8, 1, 1, 2, 4, 8, 4, 8, 4, 0, 0, 8, 8, 8])  # bytes of a value, by type
_TIFF_ENTRY = (("tag", "u2"), ("kind", "u2"), ("count", "u4"), ("value", "u4"))
_MOST_BLOCKS = 1 << 19
_MOST_TILE_PIXELS = 1 << 22


def _tiff_tags(data: bytes, order: str) -> dict[int, tuple[int, ...]]:
    """The unsigned integer tags of a TIFF file's first image, but for the ones that are not needed here."""
    (directory,) = struct.unpack_from(f"{order}I", data, 4)
    (entries,) = struct.unpack_from(f"{order}H", data, directory)
    _check_tiff_directory(data, order, directory + 2, entries)
    tags = {}
    for position in range(directory + 2, directory + 2 + 12 * entries, 12):
        tag, kind, count = struct.unpack_from(f"{order}HHI", data, position)
        if tag not in _TIFF_TAGS or kind not in _TIFF_TYPES:
            continue
        code = f"{order}{count}{_TIFF_TYPES[kind]}"
        inline = struct.calcsize(code) <= 4
        start = position + 8 if inline else struct.unpack_from(f"{order}I", data, position + 8)[0]
        tags[tag] = struct.unpack_from(code, data, start)
    return tags


def _require_one_page(data: bytes, order: str) -> None:
    """InputError where a TIFF file has another image of full size; previews (bit 0 of NewSubfileType) are none."""
    (directory,) = struct.unpack_from(f"{order}I", data, 4)
    for page in range(_MOST_PAGES):
        (entries,) = struct.unpack_from(f"{order}H", data, directory)
        end = directory + 2 + 12 * entries
        kinds = [
            struct.unpack_from(f"{order}I", data, position + 8)[0]
            for position in range(directory + 2, end, 12)
            if struct.unpack_from(f"{order}H", data, position)[0] == _SUBFILE_TYPE
        ]
        if page > 0 and not (kinds and kinds[0] & 1):
            raise InputError(_SEVERAL)
        (directory,) = struct.unpack_from(f"{order}I", data, end)
        if directory == 0:
            return
    raise InputError(_SEVERAL)


def _check_tiff_directory(data: bytes, order: str, start: int, entries: int) -> None:
    """InputError where a tag is repeated, or what the tags point to would be far more than the file has.

    A decoder reads the values of every tag, so that many tags that share the file's bytes take many times its size.
    """
    kind = np.dtype([(name, order + code) for name, code in _TIFF_ENTRY])
    if len(data) - start < entries * kind.itemsize:
        raise InputError(_TRUNCATED)
    table = np.frombuffer(data, kind, entries, start)
    sizes = _TIFF_SIZES[np.minimum(table["kind"], len(_TIFF_SIZES) - 1)] * table["count"].astype(np.int64)
    blocks = np.isin(table["tag"], (_STRIP_OFFSETS, _STRIP_COUNTS, _TILE_OFFSETS, _TILE_COUNTS))
    few = np.isin(table["tag"], tuple(_TIFF_TAGS)) & ~blocks
    counts = table["count"]
    none = (blocks | few) & (counts == 0)
    too_many = (blocks & (counts > _MOST_BLOCKS)) | (few & (counts > 8)) | none
    repeated = len(np.unique(table["tag"])) < entries
    if repeated or too_many.any() or sizes[sizes > 4].sum() > 2 * len(data):
        raise InputError(_TRUNCATED)


def _tiff_blocks(tags: dict, width: int, height: int) -> tuple[tuple[int, ...], tuple[int, ...], int]:
    """Offsets and byte counts of the strips or tiles, and how many of them the image needs."""
    if _TILE_OFFSETS in tags:
        (tile_width,), (tile_height,) = tags[_TILE_WIDTH], tags[_TILE_HEIGHT]
        if tile_width * tile_height > max(4 * width * height, _MOST_TILE_PIXELS):
            raise ValueError("a tile that is larger than the picture")
        needed = -(-width // tile_width) * -(-height // tile_height)
        return tags[_TILE_OFFSETS], tags[_TILE_COUNTS], needed
    (rows,) = tags.get(_STRIP_ROWS, (height,))
    return tags[_STRIP_OFFSETS], tags[_STRIP_COUNTS], -(-height // rows)


def _parse_pgm(data: bytes) -> ImageHeader:
    gap = rb"(?:\s|#[^\n]*\n)+"
    found = re.match(rb"P5" + gap + gap.join([rb"(\d{1,9})"] * 3) + rb"\s", data)
    if not found:
        raise InputError(_TRUNCATED)
    width, height, white = (int(number) for number in found.groups())
    header = _grey_header(width, height, 8 if white < 256 else 16, grey=True)
    end = found.end() + width * height * header.bits // 8
    if len(data) < end:
        raise InputError(_TRUNCATED)
    if data[end : end + 2] == b"P5":
        raise InputError(_SEVERAL)
    return header


def _parse_bmp(data: bytes) -> ImageHeader:
    (start,) = struct.unpack_from("<I", data, 10)
    width, height, _, bits, compression = struct.unpack_from("<iiHHI", data, 18)
    header = _grey_header(width, abs(height), bits, grey=bits == 8 and compression == 0)
    if len(data) - start < -(-width // 4) * 4 * abs(height):
        raise InputError(_TRUNCATED)
    return header


def _grey_header(width: int, height: int, bits: int, grey: bool) -> ImageHeader:
    if not grey or bits not in (8, 16):
        raise InputError("not a plain grey image of 8 or 16 bits; write the sensor's data without conversion")
    return ImageHeader(width, height, bits)


_PARSERS = {
    _PNG: _parse_png,
    b"II*\0": _parse_tiff,
    b"MM\0*": _parse_tiff,
    b"P5": _parse_pgm,
    b"BM": _parse_bmp,
}
