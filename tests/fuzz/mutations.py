"""Seeded changes of a file's bytes: blind ones, ones that know text and numbers, and ones that know a format."""

from __future__ import annotations

import io
import json
import struct
import warnings
import zipfile
import zlib
from collections.abc import Callable
from random import Random

Mutation = Callable[[bytes, Random], bytes]

NUMBERS = (
    "0", "-0", "-1", "1", "2", "255", "65536", "4294967296", "9223372036854775807", "9223372036854775808",
    "-9999999999",     "9999999999999999999", "9" * 40, "9" * 5000, "0x" + "f" * 4000, ":".join(["1"] * 300),
    "nan", "-nan", "inf", "-inf",
    "1e308", "-1e308", "1e-320", "1e999", "1e20", "0.5", "1.5", "--11", "+5", "1_000", "1e5", "0x1f", "0b11", "1,5", "",
    "''", "٣", "true", "null", ".nan", ".inf", "NaN", "Infinity", "1" + "0" * 300 + ".5",
)  # fmt: skip
VALUES = (
    "!!int ''", "!!int zz", "!!bool zz", "!!float x", "!!binary x", "!!set {a}", "!!timestamp 2001-99-99", "!own x",
    "!!python/object/apply:os.system [echo]", "2001-99-99", "2001-01-01", '"\\ud800"', '"\\0"', '"\\U00110000"',
    "&a [*a]", "*b", "[" * 60, "[" * 3000, "{a: " * 60, "- " * 50, "<<: 1", "{<<: {a: 1}}", "[[1, 2], [3, 4]]", "{}",
    "[]",     "[&a0 [x, x], " + ", ".join(f"&a{i} [{', '.join([f'*a{i - 1}'] * 9)}]" for i in range(1, 9)) + "]",
    "x" * 3000, "/" + "x/" * 2000, "../../../../etc/passwd", "/dev/zero", "a\0b", "é" * 300, "\x1b[31m", "$HOME",
    "%s %d", "# no", "'", '"', "🙂", "?", ": :", "| x", "> x", "---", "...", "%YAML 9.9", "=", "~",
)  # fmt: skip
JSON_VALUES = (
    None, True, 0, -1, 0.5, 1e308, -1e308, 1 << 63, 10**30, "", "x", "x" * 3000, "$\\x$", "\ud800", "inf", "NaN",
    [], {}, [[]] * 50, [1] * 1000, {"a": 1}, {str(i): 1 for i in range(300)},
)  # fmt: skip
SPECIAL_BYTES = (b"\0", b"\xff", b"\xff\xfe", b"\xef\xbb\xbf", b"\xed\xa0\x80", b"\r", b"\n", b"\n\n", b"#", b",", b" ",
                 b"\t", b"\x1b[2J", b"\x85", b"\xe2\x80\xa8", b"-" * 150, b"(" * 150, b"[" * 2000)  # fmt: skip


def flip_bits(data: bytes, rng: Random) -> bytes:
    """One to eight bits."""
    changed = bytearray(data)
    for _ in range(rng.choice((1, 1, 1, 2, 4, 8))):
        if changed:
            changed[rng.randrange(len(changed))] ^= 1 << rng.randrange(8)
    return bytes(changed)


def truncate(data: bytes, rng: Random) -> bytes:
    """Nothing but the begin."""
    return data[: rng.choice((0, 1, 4, 8, rng.randrange(len(data) + 1), max(len(data) - rng.randrange(1, 40), 0)))]


def cut(data: bytes, rng: Random) -> bytes:
    """Without some bytes in the middle."""
    start = rng.randrange(len(data) + 1)
    return data[:start] + data[start + rng.choice((1, 2, 4, 8, 50, 1000)) :]


def insert(data: bytes, rng: Random) -> bytes:
    """With something strange, or a piece of its own, in the middle."""
    start, source = rng.randrange(len(data) + 1), rng.randrange(len(data) + 1)
    piece = rng.choice((*SPECIAL_BYTES, rng.randbytes(16), data[source : source + rng.choice((4, 30, 500))]))
    return data[:start] + piece + data[start:]


def overwrite(data: bytes, rng: Random) -> bytes:
    """A binary number of some size in place of what is there."""
    form = rng.choice(("<B", "<H", ">H", "<I", ">I", "<Q", ">Q", "<f", "<d", ">d"))
    if form[1] in "fd":
        value = rng.choice((float("nan"), float("inf"), -1.0, 0.0, 1e38, -1e38, 1e-40, 0.5))
    else:
        top = 1 << 8 * struct.calcsize(form)
        value = rng.choice((0, 1, 2, 3, top // 2 - 1, top // 2, top - 1, top - 2, rng.randrange(top), top // 16)) % top
    piece = struct.pack(form, value)
    start = rng.randrange(min(len(data), rng.choice((64, 400, 1 << 30))) + 1)
    return data[:start] + piece + data[start + len(piece) :]


def replace_number(data: bytes, rng: Random) -> bytes:
    """Another number, or no number, in place of one word of a text."""
    return _replace_word(data, rng, rng.choice(NUMBERS))


def replace_word(data: bytes, rng: Random) -> bytes:
    """Something strange in place of one word of a text."""
    return _replace_word(data, rng, rng.choice(VALUES))


def change_lines(data: bytes, rng: Random) -> bytes:
    """Two lines exchanged, or one left out, doubled, or repeated very often."""
    lines = data.split(b"\n")
    i, j, what = rng.randrange(len(lines)), rng.randrange(len(lines)), rng.randrange(5)
    if what == 0:
        lines[i], lines[j] = lines[j], lines[i]
    elif what == 1:
        del lines[i]
    elif what == 2:
        lines.insert(j, lines[i])
    elif what == 3:
        lines[i] = lines[i][: rng.randrange(len(lines[i]) + 1)]
    else:
        lines[i:i] = [lines[i]] * rng.choice((100, 3000))
    return b"\n".join(lines)


def change_json(data: bytes, rng: Random) -> bytes:
    """Another value somewhere in a JSON file, which stays one."""
    try:
        values = json.loads(data)
    except ValueError:
        return flip_bits(data, rng)
    places = [(None, None), *_places(values)]
    parent, key = rng.choice(places)
    value = rng.choice(JSON_VALUES)
    if parent is None:
        values = value
    elif isinstance(parent, list) and rng.random() < 0.5:
        if rng.random() < 0.5:
            del parent[key]
        else:
            parent[key:key] = [parent[key]] * rng.choice((1, 7, 500))
    elif isinstance(parent, dict) and rng.random() < 0.2:
        del parent[key]
    else:
        parent[key] = value
    return json.dumps(values).encode()


def change_png(data: bytes, rng: Random) -> bytes:
    """A chunk changed, left out or doubled, with sound checksums."""
    chunks, position = [], 8
    while position + 12 <= len(data):
        (length,) = struct.unpack_from(">I", data, position)
        chunks.append((data[position + 4 : position + 8], data[position + 8 : position + 8 + length]))
        position += 12 + length
    if not chunks:
        return flip_bits(data, rng)
    i, what = rng.randrange(len(chunks)), rng.randrange(5)
    kind, body = chunks[i]
    if what < 3:
        chunks[i] = kind, rng.choice((flip_bits, truncate, insert, overwrite))(body, rng)
    elif what == 3:
        del chunks[i]
    else:
        chunks.insert(rng.randrange(len(chunks)), (rng.choice((kind, b"tRNS", b"acTL", b"PLTE", b"zTXt")), body))
    return data[:8] + b"".join(
        struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body)) for kind, body in chunks
    )


def change_tiff(data: bytes, rng: Random) -> bytes:
    """A tag of the first directory changed, doubled or repeated to the largest number of tags."""
    order = "<" if data[:2] == b"II" else ">"
    try:
        (start,) = struct.unpack_from(order + "I", data, 4)
        (count,) = struct.unpack_from(order + "H", data, start)
        entries = [list(struct.unpack_from(order + "HHII", data, start + 2 + 12 * i)) for i in range(count)]
    except struct.error:
        return flip_bits(data, rng)
    if not entries:
        return flip_bits(data, rng)
    entry = rng.choice(entries)
    what = rng.randrange(5)
    if what == 0:
        _other(rng.choice(entries), rng)
    elif what == 1:
        entries.append(_other(list(entry), rng))
    elif what == 2:
        entries.remove(entry)
    else:
        first, kind = rng.choice((256, 258, 65000 - 32768, 400)), rng.choice((1, 3, 4, 12))
        many = rng.choice((20, 84, 3000))
        entries += [[first + i % 30000, kind, len(data) // rng.choice((8, 4, 2, 1)), 8] for i in range(many)]
        entries.sort()
    table = struct.pack(order + "H", len(entries)) + b"".join(struct.pack(order + "HHII", *e) for e in entries)
    return data[:4] + struct.pack(order + "I", len(data)) + data[8:] + table + b"\0\0\0\0"


def change_zip(data: bytes, rng: Random) -> bytes:
    """An archive written anew with a member changed, left out, doubled, renamed, or packed in another way."""
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            members = [(member.filename, archive.read(member)) for member in archive.infolist()]
    except Exception:
        return flip_bits(data, rng)
    i, what = rng.randrange(len(members)), rng.randrange(8)
    name, body = members[i]
    if what < 4:
        members[i] = name, rng.choice((change_npy, change_npy, flip_bits, truncate, insert, overwrite))(body, rng)
    elif what == 4:
        del members[i]
    elif what == 5:
        members.append((name, change_npy(body, rng)))
    elif what == 6:
        members[i] = rng.choice((name[:-4], "../" + name, "x" * 3000, "é", "a\0")), body
    else:
        members[i] = name, body + bytes(rng.choice((1, 100_000, 1 << 24)))
    method = rng.choice((zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED, zipfile.ZIP_LZMA, zipfile.ZIP_BZIP2))
    buffer = io.BytesIO()
    with warnings.catch_warnings(), zipfile.ZipFile(buffer, "w", method) as archive:
        warnings.simplefilter("ignore")  # of doubled names
        for name, body in members:
            archive.writestr(name, body)
    changed = buffer.getvalue()
    return flip_bits(changed, rng) if rng.random() < 0.2 else changed


def change_npy(data: bytes, rng: Random) -> bytes:
    """The header of a .npy changed as text, its length kept right."""
    length = int.from_bytes(data[8:10], "little")
    text, rest = data[10 : 10 + length], data[10 + length :]
    what = rng.randrange(4)
    if what == 0:
        side = rng.choice(("True", "-1", "9" * 30, "99999, 99999", "1, " * 50, "1e3", "0", "1.5", "()", "", "3L"))
        at = text.find(b"(") + 1
        text = text[:at] + side.encode() + b", " * rng.randrange(2) + text[at:]
    elif what == 1:
        other = rng.choice((b"|O", b">f4", b"<U9", b"<M8[s]", b"|V99", b"f"))
        text = text.replace(rng.choice((b"<f4", b"<f8", b"|u1")), other)
    elif what == 2:
        text = rng.choice((b"{((((", b"{1.5: 2, 'a': 3}", b"[" * 5000, b"", b"{'descr': ", b"-" * 200, b"1" * 9000))
    else:
        text = rng.choice((flip_bits, insert, cut, replace_number))(text, rng)
    return data[:8] + struct.pack("<H", min(len(text), 65535)) + text + rest


BLIND: tuple[Mutation, ...] = (flip_bits, truncate, cut, insert, overwrite)
TEXT: tuple[Mutation, ...] = (
    replace_number, replace_number, replace_number, replace_word, replace_word, change_lines,
    insert, cut, flip_bits, truncate,
)  # fmt: skip
JSON: tuple[Mutation, ...] = (change_json, change_json, change_json, *TEXT)
PNG: tuple[Mutation, ...] = (change_png, *BLIND)
TIFF: tuple[Mutation, ...] = (change_tiff, change_tiff, *BLIND)
NPZ: tuple[Mutation, ...] = (change_zip, change_zip, change_zip, *BLIND)
NPY: tuple[Mutation, ...] = (change_npy, *BLIND)
MIXED: tuple[Mutation, ...] = (*BLIND, replace_number, replace_number, replace_word, change_lines)
"""Of a text header before binary values."""


def _replace_word(data: bytes, rng: Random, word: str) -> bytes:
    separators = b" \t\n,:[]{}&="
    text = b" " + data[:20_000]
    starts = [i for i in range(len(text) - 1) if text[i + 1] not in separators and text[i] in separators]
    if not starts:
        return word.encode("utf-8", "surrogatepass")
    start = end = rng.choice(starts)
    while end < len(data) and data[end] not in separators:
        end += 1
    return data[:start] + word.encode("utf-8", "surrogatepass") + data[end:]


def _places(values: object) -> list[tuple[dict | list, object]]:
    """(container, key) of every value."""
    items = values.items() if isinstance(values, dict) else enumerate(values) if isinstance(values, list) else ()
    return [place for key, value in items for place in ((values, key), *_places(value))]


def _other(entry: list[int], rng: Random) -> list[int]:
    position = rng.randrange(4)
    limit = (1 << 16) - 1 if position < 2 else (1 << 32) - 1
    some = (0, 1, 2, 3, 4, 8, 16, 17, 256, 257, 273, 322, limit, limit // 2, rng.randrange(limit))
    entry[position] = rng.choice(some)
    return entry
