"""YAML holds plain values alone, within limits that hold before memory is taken."""

from __future__ import annotations

import pytest

from polarmap.benchmark.spec import read_spec
from polarmap.errors import InputError
from polarmap.io.formats.yaml_text import MAX_YAML_BYTES, parse_yaml, read_yaml
from polarmap.io.recording.camera_file import read_camera_file
from polarmap.pipeline.config import Config, read_config
from polarmap.prior.network_spec import network_spec

CAMERA = "width: 64\nheight: 48\nfx: 50\nfy: 50\ncx: 31\ncy: 23\npolarization: none\nbit_depth: 8\n"
BOMB = "[" + ", ".join(["&a0 [x, x]", *(f"&a{i} [{', '.join([f'*a{i - 1}'] * 9)}]" for i in range(1, 9))]) + "]"
CLAIMED = r"line 2: .* is no (int|float), which its tag claims"
HUGE = {
    "decimal": "9" * 5000,
    "hexadecimal": "0x" + "f" * 4000,
    "octal": "0" + "7" * 5000,
    "binary": "0b" + "1" * 5000,
    "sexagesimal": ":".join(["1"] * 340),
    "sexagesimal float": ":".join(["1"] * 340) + ".5",
    "65 bits": str(1 << 63),
    "hexadecimal of 65 bits": "-0x8000000000000001",
}


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("a: [1, -0x1f, 0b11, 017, 1:30, 1_000]", {"a": [1, -31, 3, 15, 90, 1000]}),
        ("a: [1.5, .5, 1e5, 1.0e+5, 1:30.5, .inf]", {"a": [1.5, 0.5, "1e5", 1e5, 90.5, float("inf")]}),
        ("a: [yes, No, true, ~, null, ]", {"a": [True, False, True, None, None]}),
        ("a: !!str 5\nb: !!int '7'\nc: !!float 1\nd: !!bool on\ne: !!null ''\nf: !!seq []\ng: !!map {}\nh: ! x",
         {"a": "5", "b": 7, "c": 1.0, "d": True, "e": None, "f": [], "g": {}, "h": "x"}),
        ("a: &x [1, 2]\nb: *x", {"a": [1, 2], "b": [1, 2]}),
        ("x: &x {a: 1, b: 2}\ny: {<<: *x, b: 3}", {"x": {"a": 1, "b": 2}, "y": {"a": 1, "b": 3}}),
        ("{a: 1, a: 2}", {"a": 2}),
        ("1: a\ntrue: b", {1: "b"}),
        ("[2001-01-01, 2001-99-99, 2001-01-01 10:00:00, =]", ["2001-01-01", "2001-99-99", "2001-01-01 10:00:00", "="]),
        ("[!!float 1e5, !!float 1, !!float 1:30.5, !!float -.INF, !!int 0x1F]", [1e5, 1.0, 90.5, -float("inf"), 31]),
        ("%YAML 1.1\n---\na: 1\n...\n", {"a": 1}),
        ("'" + "9" * 5000 + "'", "9" * 5000),
        ("", None),
    ],
    ids=lambda text: ascii(text)[:30],
)  # fmt: skip
def test_plain_values(text, value):
    assert parse_yaml(text, "file") == value
    assert parse_yaml(text.encode(), "file") == value
    assert parse_yaml(text.encode("utf-8-sig"), "file") == value
    assert parse_yaml(text.encode("utf-16"), "file") == value


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        *((f"a: 1\nb: {number}", "line 2: a(n integer| number) of") for number in HUGE.values()),
        *((f"\na: !!int {text}", CLAIMED) for text in ("''", "zz", "+", "0x", "1.5", "'1:'")),
        *((f"\na: !!float {text}", CLAIMED) for text in ("''", "zz", "1:x", "++1")),
        *((f"\na: !!bool {text}", "line 2: .* is no bool") for text in ("''", "zz", "1", "y")),
        ("a: !!null 1", "line 1: '1' is no null"),
        *((f"a: {value}", "line 1: the tag") for value in (
            "!!timestamp 2001-01-01", "!!binary aGk=", "!!set {a}", "!!omap [a: 1]", "!!pairs [a: 1]", "!own 1",
            "!!python/object/apply:os.system [echo]", "!!python/none ''", "!!map []", "!!seq {}", "!!str [a]",
            "!<int> 5",
        )),
        ('\n"\\ud800": 1', "line 2: half of a surrogate pair"),
        ('a: ["\\udfff"]', "half of a surrogate pair"),
        ('"\\U00110000"', r"line 1 \(chr"),
        ("a:\n  \x07", "line 2: a control character"),
        ("&a [*a]", "an alias inside of what it stands for"),
        ("&a {b: [*a]}", "an alias inside of what it stands for"),
        ("[*a]", "undefined alias"),
        ("a: " + BOMB, "more than 20000 values, aliases written out"),
        ("[&m {a: 1, b: 2}" + "".join(f", &m{i} {{<<: [{', '.join([f'*m{i - 1}'.replace('*m-1', '*m')] * 9)}]}}"
                                      for i in range(8)) + "]", "more than 20000 values"),
        ("[" + "a," * 25_000 + "]", "more than 20000 values"),
        ("[" * 100_000, "in each other"),
        ("{a: " * 40 + "1" + "}" * 40, "in each other"),
        ("- " * 1000, "in each other"),
        ("? [a]\n: b", "line 1: found unhashable key"),
        ("a: 1\n--- b", "line 2: but found another document"),
        ("a: [1,\nb", "line 2"),
        ("a" * (MAX_YAML_BYTES + 1), "more than the"),
        (b"a: \xff", "not a text in UTF-8"),
    ],
    ids=lambda text: ascii(text)[:30],
)  # fmt: skip
def test_what_is_refused(text, problem):
    with pytest.raises(InputError, match=problem) as raised:
        parse_yaml(text, "file.yaml")
    message = str(raised.value)
    assert message.startswith("file.yaml: ") and len(message) < 300 and message.isprintable()


def test_a_source_of_any_length_is_cut():
    with pytest.raises(InputError) as raised:
        parse_yaml("[", "--set a.b=" + "[" * 5000)
    assert len(str(raised.value)) < 300


def test_the_file_is_named(tmp_path):
    (tmp_path / "a.yaml").write_text("a: 1\n")
    assert read_yaml(tmp_path / "a.yaml") == {"a": 1}
    with pytest.raises(InputError, match=r"a\.yaml: 5 bytes, more than the 4 "):
        read_yaml(tmp_path / "a.yaml", limit=4)
    with pytest.raises(InputError, match=r"b\.yaml: no such file"):
        read_yaml(tmp_path / "b.yaml")


READERS = {
    "camera.yaml": (read_camera_file, CAMERA + "images: {}\n"),
    "config.yaml": (read_config, "paper: {{max_steps: {}}}\n"),
    "spec.yaml": (read_spec, "sequences: [{{name: a, path: b}}]\nmethods: [{{name: m}}]\nseeds: [{}]\n"),
    "net.yaml": (lambda path: network_spec(path.with_suffix(".onnx")), "output_space: depth\nmean: [{}, 0, 0]\n"),
}


@pytest.mark.parametrize("name", READERS)
@pytest.mark.parametrize(
    "value",
    [*HUGE.values(), "!!int ''", "!!bool zz", "!!python/object/apply:os.system [echo]", '"\\ud800"', BOMB],
    ids=lambda text: ascii(text)[:30],
)
def test_every_reader_of_yaml_has_the_same_guard(tmp_path, name, value):
    read, text = READERS[name]
    (tmp_path / name).write_text(text.format(value))
    with pytest.raises(InputError, match=rf"{name}: not valid YAML at line \d: ") as raised:
        read(tmp_path / name)
    assert len(str(raised.value)) < 300


def test_settings_have_the_same_guard():
    for value in (*HUGE.values(), "!!int zz", BOMB):
        with pytest.raises(InputError, match="not valid YAML") as raised:
            Config().with_settings([f"paper.max_steps={value}"])
        assert len(str(raised.value)) < 500
