"""Damaged and malicious files end in one short line of the package's own, before they take memory or time."""

from __future__ import annotations

import io
import json
import os
import resource
import struct
import zipfile
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest
from conftest import SHARED
from fuzz.__main__ import fuzz

from polarmap.benchmark.cells import cells_of
from polarmap.benchmark.configuration import configuration
from polarmap.benchmark.spec import read_spec
from polarmap.errors import InputError
from polarmap.io.formats.colmap import read_colmap_model
from polarmap.io.formats.depth_array import read_depth_array
from polarmap.io.formats.images import read_colours, read_image, read_picture
from polarmap.io.formats.json_text import read_json
from polarmap.io.formats.ply_reader import read_ply
from polarmap.io.recording.camera_file import read_camera_file
from polarmap.io.recording.rgbd.intrinsics import read_intrinsics
from polarmap.io.run_folder.keyframe_file import read_keyframe, replace_pose
from polarmap.pipeline.config import read_config
from polarmap.prior.network_spec import network_spec

SHAPE = (12, 16)
POSE = "0.7071067811865476 0.7071067811865476 0 0 0 0 0"


def refused(read, path: Path, problem: str = ".") -> None:
    """That reading ends in the package's own error: short, of one line, and soon known without much memory."""
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(InputError, match=problem) as raised:
        read(path)
    message = str(raised.value)
    assert len(message) < 500 and message.isprintable()
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 300_000  # kB


# --- keyframes and arrays ---


def keyframe_arrays() -> dict[str, np.ndarray]:
    floats = {name: np.zeros(SHAPE, np.float32) for name in ("azimuth", "zenith", "sigma", "confidence")}
    codes = {name: np.zeros(SHAPE, np.uint8) for name in ("label", "origin")}
    depth = {"depth": np.ones(SHAPE, np.float32), "normal": np.zeros((*SHAPE, 3), np.float32)}
    rest = {"K": np.diag([9.0, 9.0, 1.0]), "T_world_camera": np.eye(4), "timestamp": np.float64(0.5)}
    return {**depth, **floats, **codes, **rest}


def npy(array: np.ndarray) -> bytes:
    buffer = io.BytesIO()
    np.save(buffer, array)
    return buffer.getvalue()


def header(text: str) -> bytes:
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text.encode()


def write_npz(path: Path, method: int = zipfile.ZIP_STORED, **members: bytes | None) -> Path:
    """A keyframe with some members replaced, or left out where None."""
    files = {name: npy(array) for name, array in keyframe_arrays().items()} | members
    with zipfile.ZipFile(path, "w", method) as archive:
        for name, data in files.items():
            if data is not None:
                archive.writestr(f"{name}.npy", data)
    return path


@pytest.mark.parametrize("method", [zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED])
def test_sound_keyframes_are_read(tmp_path, method):
    path = write_npz(tmp_path / "000003.npz", method)
    assert read_keyframe(path).depth.shape == read_keyframe(path, (16, 12)).depth.shape == SHAPE
    refused(lambda p: read_keyframe(p, (32, 24)), path, "'depth' is float32 12x16, expected float32 24x32")


@pytest.mark.parametrize(
    "text",
    [
        "{((((", "{1.5: 2, 'a': 3}", "", "[" * 9000, "-" * 200, "{'descr': '<f4'}", "1" * 60000,
        "{'descr': '<f4', 'fortran_order': False, 'shape': (True, 16), }",
        "{'descr': '<f4', 'fortran_order': False, 'shape': (-12, 16), }",
        "{'descr': '<f4', 'fortran_order': False, 'shape': (" + "9" * 500 + ", 16), }",
        "{'descr': '<f4', 'fortran_order': 0, 'shape': (12, 16), }",
        "{'descr': [('a', '<f4')], 'fortran_order': False, 'shape': (12, 16), }",
        "{'descr': '|O', 'fortran_order': False, 'shape': (12, 16), }",
        "{'descr': '<q9', 'fortran_order': False, 'shape': (12, 16), }",
        "{'descr': '<f4', 'descr': '<f4', 'fortran_order': False, 'shape': (12, 16), }",
        "{'descr': '<f4', 'fortran_order': False, 'shape': (100000, 100000), }",
        "{'descr': '<f4', 'fortran_order': False, 'shape': (99999999999, 0), }",
    ],
    ids=range(17),
)  # fmt: skip
def test_headers_of_arrays_are_not_evaluated(tmp_path, text):
    data = header(text) + bytes(4 * 12 * 16)
    refused(read_keyframe, write_npz(tmp_path / "000003.npz", depth=data), r"000003\.npz: ")
    (tmp_path / "a.npy").write_bytes(data)
    refused(read_depth_array, tmp_path / "a.npy", r"a\.npy: ")


def test_headers_in_another_order_are_read(tmp_path):
    text = '{"shape": (12, 16), "descr": "<f4", "fortran_order": True}\n'
    (tmp_path / "a.npy").write_bytes(header(text) + np.ones(SHAPE, np.float32).tobytes())
    assert (read_depth_array(tmp_path / "a.npy") == 1).all()


@pytest.mark.parametrize("method", [zipfile.ZIP_LZMA, zipfile.ZIP_BZIP2])
def test_keyframes_packed_in_other_ways_are_refused(tmp_path, method):
    refused(read_keyframe, write_npz(tmp_path / "000003.npz", method), "packed by a method that is not read")


def test_a_zip_bomb_is_not_unpacked(tmp_path):
    path = tmp_path / "000003.npz"
    side = 1 << 13
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        text = f"{{'descr': '<f4', 'fortran_order': False, 'shape': ({side}, {side}), }}"
        zeros = bytes(1 << 20)
        with archive.open("depth.npy", "w", force_zip64=True) as member:
            member.write(header(text))
            for _ in range(4 * side * side >> 20):
                member.write(zeros)
        small = archive.infolist()[0].compress_size
    assert small < 2_000_000
    data = path.read_bytes()
    for reader in (read_keyframe, lambda p: replace_pose(p, np.eye(4))):
        refused(reader, path, "that unpack to 268435[0-9]{3}; ")
    assert path.read_bytes() == data


def test_archives_with_too_much_in_their_directory(tmp_path):
    path = tmp_path / "000003.npz"
    with zipfile.ZipFile(path, "w") as archive:
        for i in range(3000):
            archive.writestr(f"{i}.npy", b"")
    refused(read_keyframe, path, "directory larger than one of a few arrays")


def test_an_array_that_is_there_twice(tmp_path):
    path = write_npz(tmp_path / "000003.npz")
    with zipfile.ZipFile(path, "a") as archive, pytest.warns(UserWarning):
        archive.writestr("depth.npy", npy(np.ones(SHAPE, np.float32)))
    refused(read_keyframe, path, "has an array twice")


@pytest.mark.parametrize(
    ("name", "value"),
    [("normal", np.inf), ("azimuth", -np.inf), ("sigma", -1.0), ("zenith", np.inf)],
)
def test_keyframes_with_impossible_values(tmp_path, name, value):
    array = keyframe_arrays()[name].copy()
    array.flat[5] = value
    refused(read_keyframe, write_npz(tmp_path / "000003.npz", **{name: npy(array)}), name)


def test_a_pipe_in_the_place_of_a_keyframe(tmp_path):
    os.mkfifo(tmp_path / "000003.npz")
    (tmp_path / "000004.npz").symlink_to("/dev/zero")
    for name in ("000003.npz", "000004.npz"):
        refused(read_keyframe, tmp_path / name, "not a regular file")


# --- JSON ---


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ('{"width": ' + "9" * 5000 + "}", "an integer of 5000 digits"),
        ('{"width": ' + "9" * 20 + "}", "more than 64 bits"),
        ('{"width": NaN}', "NaN is no number"),
        ('{"width": -Infinity}', "-Infinity is no number"),
        ('{"width": 1e999}', "too large"),
        ("[" * 100_000, "a.json: "),
        ("[" * 40 + "]" * 40, "more than 32 lists"),
        ('{"\\ud800": 1}', "surrogate"),
        ('{"a": ["\\udfff"]}', "surrogate"),
        ("{" + ",".join(f'"{i}":1' for i in range(10_001)) + "}", "more than 10000"),
        ('{"a": 1}\n{', "line 2"),
    ],
    ids=range(11),
)
def test_json_is_limited(tmp_path, text, problem):
    (tmp_path / "a.json").write_text(text)
    refused(read_json, tmp_path / "a.json", problem)
    refused(read_intrinsics, tmp_path / "a.json", r"a\.json: ")


@pytest.mark.parametrize("value", ['"80"', "true", "80.5", "null", "[80]", "1e300", "-80", "0"])
def test_intrinsics_are_numbers(tmp_path, value):
    matrix = [60, 0, 0, 0, 60, 0, 39.5, 29.5, 1]
    text = json.dumps({"width": 80, "height": 60, "intrinsic_matrix": matrix})
    (tmp_path / "good.json").write_text(text)
    assert read_intrinsics(tmp_path / "good.json").camera.width == 80
    (tmp_path / "a.json").write_text(text.replace("80", value))
    refused(read_intrinsics, tmp_path / "a.json", r"a\.json: ")


# --- PLY and COLMAP ---

PLY = "ply\nformat {} 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
TRIANGLE = np.arange(9, dtype="<f4").tobytes()


@pytest.mark.parametrize(
    ("lists", "count", "body", "problem"),
    [
        ("float double", 1, struct.pack("<f3d", np.nan, 0, 1, 2), "not understood"),
        ("double int", 1, struct.pack("<d3i", np.inf, 0, 1, 2), "not understood"),
        ("uchar double", 1, struct.pack("<B3d", 3, 0, 1, 2), "need not be whole"),
        ("int int", 1, struct.pack("<i3i", -1, 0, 1, 2), "claims -1 numbers"),
        ("uchar int", 10**9, b"\0" * 100, "truncated: 1000000000 of face, 100 bytes are left"),
        ("uchar int", 5_000_000, b"\0" * 5_000_000, "more than 4194304; save it with triangles"),
        ("uint int", 1, struct.pack("<I3i", 1 << 31, 0, 1, 2), "truncated"),
    ],
)
def test_faces_of_binary_meshes(tmp_path, lists, count, body, problem):
    text = (
        PLY.format("binary_little_endian") + f"element face {count}\nproperty list {lists} vertex_indices\nend_header\n"
    )
    (tmp_path / "a.ply").write_bytes(text.encode() + TRIANGLE + body)
    refused(read_ply, tmp_path / "a.ply", problem)


@pytest.mark.parametrize(
    ("count", "row", "problem"),
    [
        (1, "nan 0 1 2", "is no face of numbers"),
        (1, "inf 0 1 2", "is no face of numbers"),
        (1, "3.5 0 1 2", "not whole"),
        (1, "3 0 1.5 2", "not whole"),
        (1, "-1 0 1 2", "fewer numbers than it claims"),
        (10**9, "0\n0", "truncated: 1000000000 of face, only 2 are there"),
    ],
)
def test_faces_of_meshes_in_text(tmp_path, count, row, problem):
    text = PLY.format("ascii") + f"element face {count}\nproperty list uchar int vertex_indices\nend_header\n"
    (tmp_path / "a.ply").write_text(text + "0 0 0\n1 0 0\n0 1 0\n" + row + "\n")
    refused(read_ply, tmp_path / "a.ply", problem)


def test_more_vertices_than_a_file_holds(tmp_path):
    for kind, problem in (("ascii", "truncated: 10000000000 of vertex in"), ("binary_little_endian", "truncated")):
        text = PLY.format(kind).replace("vertex 3", "vertex 10000000000") + "end_header\n0 0 0\n"
        (tmp_path / "a.ply").write_text(text)
        refused(read_ply, tmp_path / "a.ply", problem)
    (tmp_path / "a.ply").write_text("ply\nformat binary_little_endian 1.0\nelement vertex 10000000000\nend_header\n")
    refused(read_ply, tmp_path / "a.ply", "no vertices with x, y and z")


def write_model(folder: Path, cameras: str = "", images: str = "", points: str = "") -> Path:
    folder.mkdir(exist_ok=True)
    (folder / "cameras.txt").write_text(cameras or "7 PINHOLE 80 60 60 62 40 30\n")
    (folder / "images.txt").write_text(images or f"1 {POSE} 7 a.png\n1 2 11 3 4 9007199254740993\n")
    (folder / "points3D.txt").write_text(points or "11 1 2 3 10 20 30 0.5 1 0\n9007199254740993 4 5 6 0 0 0 0.5 1 0\n")
    return folder


def test_ids_of_many_digits_are_exact(tmp_path):
    model = read_colmap_model(write_model(tmp_path / "model"))
    np.testing.assert_array_equal(model.positions_of(model.images[0].point_ids), [[1, 2, 3], [4, 5, 6]])


@pytest.mark.parametrize(
    "number", ["--11", "-", "9999999999999999999", "9223372036854775808", "1e3", "٣", "1_0", "9" * 5000]
)
def test_ids_that_are_none(tmp_path, number):
    for part, text in (
        ("points", f"{number} 1 2 3 10 20 30 0.5 1 0\n"),
        ("images", f"1 {POSE} 7 a.png\n1 2 {number}\n"),
        ("images", f"1 {POSE} {number} a.png\n1 2 11\n"),
        ("cameras", f"{number} PINHOLE 80 60 60 62 40 30\n"),
        ("cameras", f"7 PINHOLE {number} 60 60 62 40 30\n"),
    ):
        refused(read_colmap_model, write_model(tmp_path / "model", **{part: text}), f"{part}.*line")


def test_lines_without_end(tmp_path):
    model = write_model(tmp_path / "model", images=f"1 {POSE} 7 a.png\n" + "1 " * (1 << 21))
    refused(read_colmap_model, model, r"images\.txt, line 2: longer than")


# --- pictures ---


def tiff(entries: list[tuple[int, int, int, int]], pixels: bytes) -> bytes:
    """A TIFF file of these (tag, type, count, value), the pixels after its first 8 bytes."""
    table = struct.pack("<H", len(entries)) + b"".join(struct.pack("<HHII", *entry) for entry in entries) + bytes(4)
    return b"II*\0" + struct.pack("<I", 8 + len(pixels)) + pixels + table


PLAIN = [(256, 4, 1, 64), (257, 4, 1, 48), (258, 3, 1, 8), (259, 3, 1, 1), (262, 3, 1, 1), (273, 4, 1, 8),
         (277, 3, 1, 1), (278, 4, 1, 48), (279, 4, 1, 64 * 48)]  # fmt: skip


def test_a_plain_tiff_is_read(tmp_path):
    pixels = bytes(range(256)) * 12
    (tmp_path / "a.tif").write_bytes(tiff(PLAIN, pixels))
    assert read_image(tmp_path / "a.tif").tobytes() == pixels


@pytest.mark.parametrize(
    "entries",
    [
        [*PLAIN, *((256, 4, 1, 64) for _ in range(60_000))],
        [*PLAIN, (257, 4, 1, 4800)],
        [*PLAIN, *((tag, 1, 3_000_000, 8) for tag in range(280, 340))],
        [*PLAIN, *((tag, 1, 3_000_000, 8) for tag in range(40_000, 43_000))],
        [(tag, kind, 700_000 if tag in (273, 279) else count, value) for tag, kind, count, value in PLAIN],
        [(tag, kind, 0 if tag == 258 else count, value) for tag, kind, count, value in PLAIN],
        [*PLAIN[:5], (277, 3, 1, 1), (322, 4, 1, 1 << 20), (323, 4, 1, 1 << 20), (324, 4, 1, 8), (325, 4, 1, 3072)],
    ],
    ids=["repeated", "twice", "known", "unknown", "strips", "none", "tile"],
)
def test_tags_that_would_take_memory(tmp_path, entries):
    (tmp_path / "a.tif").write_bytes(tiff(entries, bytes(3_000_000)))
    refused(lambda path: read_image(path, (64, 48)), tmp_path / "a.tif", "truncated or corrupt")


def png_chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def png(width: int, height: int, chunks: list[tuple[bytes, bytes]]) -> bytes:
    head = png_chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0))
    return b"\x89PNG\r\n\x1a\n" + head + b"".join(png_chunk(*chunk) for chunk in chunks) + png_chunk(b"IEND", b"")


def test_pictures_larger_than_their_camera_are_not_decoded(tmp_path):
    (tmp_path / "a.png").write_bytes(png(30_000, 2000, [(b"IDAT", zlib.compress(bytes(30_001 * 2000), 1))]))
    refused(lambda path: read_image(path, (64, 48)), tmp_path / "a.png", "30000x2000 pixels, expected 64x48")
    refused(lambda path: read_colours(path, 4096), tmp_path / "a.png", "more than the 4096 that are expected")
    (tmp_path / "a.png").write_bytes(png(30_000, 20_000, [(b"IDAT", b"")]))
    refused(read_picture, tmp_path / "a.png", "no usable image size")
    with open(tmp_path / "a.png", "ab") as file:
        file.truncate(1 << 25)
    refused(lambda path: read_image(path, (64, 48)), tmp_path / "a.png", "33554432 bytes, more than")


def test_pictures_of_endless_parts(tmp_path):
    (tmp_path / "a.png").write_bytes(png(64, 48, [(b"teXt", b"")] * 200_000))
    refused(read_image, tmp_path / "a.png", "truncated or corrupt")
    data = cv2.imencode(".jpg", np.zeros((48, 64), np.uint8), [cv2.IMWRITE_JPEG_PROGRESSIVE, 1])[1].tobytes()
    (tmp_path / "a.jpg").write_bytes(data)
    assert read_picture(tmp_path / "a.jpg").shape == (48, 64)
    last = data.rindex(b"\xff\xda")
    (tmp_path / "a.jpg").write_bytes(data[:last] + data[last:-2] * 3000 + data[-2:])
    refused(read_picture, tmp_path / "a.jpg", "truncated or corrupt")


# --- names ---


def test_names_longer_than_the_file_system_allows(tmp_path):
    spec = tmp_path / "spec.yaml"
    for name in ("x" * 3000, "x/" * 3000, '"a\\0b"'):
        spec.write_text(f"sequences: [{{name: a, path: {name}}}]\nmethods: [{{name: m}}]\n")
        refused(lambda path: [configuration(cell) for cell in cells_of(read_spec(path))], spec, "sequence a: ")
        spec.write_text(f"sequences: [{{name: a, synth: scene room}}]\nmethods: [{{name: m, prior: {name}}}]\n")
        refused(lambda path: [configuration(cell) for cell in cells_of(read_spec(path))], spec, "method m: ")


# --- the cases that are kept beside the repository ---

HOSTILE = SHARED / "cases" / "hostile"
READERS = {
    "camera.yaml": read_camera_file,
    "config.yaml": lambda path: read_config(path).to_yaml(),
    "points3D.txt": lambda path: read_colmap_model(path.parent),
    "a.json": read_intrinsics,
    "000003.npz": read_keyframe,
    "a.npy": read_depth_array,
    "a.ply": read_ply,
    "net.yaml": lambda path: network_spec(path.with_suffix(".onnx")),
    "spec.yaml": lambda path: [configuration(cell) for cell in cells_of(read_spec(path))],
}
CASES = [path for path in sorted(HOSTILE.glob("*/*")) if path.name in READERS]


@pytest.mark.skipif(not CASES, reason="the hostile files (../shared/cases/hostile) are not on this machine")
@pytest.mark.parametrize("path", CASES or [None], ids=lambda path: path and path.parent.name)
def test_kept_cases(path):
    refused(READERS[path.name], path)


# --- what nobody thought of ---


@pytest.mark.slow
def test_changed_files_of_every_reader():
    """A few of the inputs that `make fuzz` tries; in a process of its own, whose memory and time are limited."""
    assert fuzz(count=800, seed=15) == []
