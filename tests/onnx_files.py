"""ONNX files made by hand: a protocol buffer is a list of (field number, varint or bytes)."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np

FLOAT, UINT8, INT64, BOOL, DOUBLE = 1, 2, 7, 9, 11  # ONNX element types


def varint(value: int) -> bytes:
    out = bytearray()
    while value > 127:
        out.append(value & 127 | 128)
        value >>= 7
    return bytes([*out, value])


def message(*fields: tuple[int, int | bytes | str]) -> bytes:
    out = b""
    for number, value in fields:
        if isinstance(value, int):
            out += varint(number << 3) + varint(value)
        else:
            data = value.encode() if isinstance(value, str) else value
            out += varint(number << 3 | 2) + varint(len(data)) + data
    return out


def tensor(name: str, shape: tuple[int | str, ...], element: int = FLOAT) -> bytes:
    dims = [(1, message((1 if isinstance(side, int) else 2, side))) for side in shape]
    return message((1, name), (2, message((1, message((1, element), (2, message(*dims)))))))


def node(operator: str, inputs: Iterable[str], output: str, *attributes: bytes) -> bytes:
    return message(*((1, name) for name in inputs), (2, output), (4, operator), *((5, a) for a in attributes))


def onnx_file(path: Path, nodes: list[bytes], inputs: list[bytes], outputs: list[bytes]) -> Path:
    graph = message(*((1, n) for n in nodes), (2, "graph"), *((11, i) for i in inputs), *((12, o) for o in outputs))
    path.write_bytes(message((1, 8), (7, graph), (8, message((1, ""), (2, 13)))))
    return path


def identity(path: Path, shape: tuple[int | str, ...]) -> Path:
    """A network whose 'depth' is its input."""
    return onnx_file(path, [node("Identity", "x", "y")], [tensor("x", shape)], [tensor("y", shape)])


def mean_over(path: Path, axis: int, shape: tuple, output_shape: tuple) -> Path:
    axes = message((1, "axes"), (8, axis), (20, 7))
    return onnx_file(path, [node("ReduceMean", "x", "y", axes)], [tensor("x", shape)], [tensor("y", output_shape)])


def answer(path: Path, depth: np.ndarray, shape: tuple[int | str, ...], element: int = FLOAT) -> Path:
    """A network that gives the same depth, float32 h×w, whatever it is shown."""
    dims = [(1, side) for side in (1, 1, *depth.shape)]
    value = message(*dims, (2, FLOAT), (9, depth.astype("<f4").tobytes()))
    constant = node("Constant", (), "y", message((1, "value"), (5, value), (20, 4)))
    return onnx_file(path, [constant], [tensor("x", shape, element)], [tensor("y", ("n", "c", "h", "w"))])


def endless(path: Path, shape: tuple[int | str, ...]) -> Path:
    """A network that never ends: a loop whose condition stays true."""
    nodes = [node("Identity", ("go",), "on"), node("Identity", ("a",), "b")]
    inputs = [tensor("i", (), INT64), tensor("go", (), BOOL), tensor("a", shape)]
    outputs = [tensor("on", (), BOOL), tensor("b", shape)]
    body = message(*((1, n) for n in nodes), (2, "body"), *((11, i) for i in inputs), *((12, o) for o in outputs))
    true = message((2, BOOL), (9, b"\1"))
    always = node("Constant", (), "t", message((1, "value"), (5, true), (20, 4)))
    loop = node("Loop", ("", "t", "x"), "y", message((1, "body"), (6, body), (20, 5)))
    return onnx_file(path, [always, loop], [tensor("x", shape)], [tensor("y", shape)])


def huge(path: Path, shape: tuple[int | str, ...]) -> Path:
    """A network that asks for 4 TiB."""
    size = message((1, 1), (2, INT64), (9, (1 << 40).to_bytes(8, "little")))
    nodes = [
        node("Constant", (), "s", message((1, "value"), (5, size), (20, 4))),
        node("ConstantOfShape", ("s",), "c"),
        node("ReduceMean", ("c",), "m", message((1, "keepdims"), (3, 0), (20, 2))),
        node("Add", ("x", "m"), "y"),
    ]
    return onnx_file(path, nodes, [tensor("x", shape)], [tensor("y", shape)])


def with_data_at(path: Path, location: str, shape: tuple[int, ...]) -> Path:
    """A network whose weights lie in another file."""
    entries = [(13, message((1, "location"), (2, location)))]
    weights = message(*((1, side) for side in shape), (2, FLOAT), (8, "w"), *entries, (14, 1))
    graph = message(
        (1, node("Add", ("x", "w"), "y")),
        (2, "graph"),
        (5, weights),
        (11, tensor("x", shape)),
        (12, tensor("y", shape)),
    )
    path.write_bytes(message((1, 8), (7, graph), (8, message((1, ""), (2, 13)))))
    return path
