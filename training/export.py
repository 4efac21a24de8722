"""Write a checkpoint's network as the ONNX file that the package ships.

    python -m training.export RUN/checkpoint.pt src/polarmap/prior/polarnet.onnx

The running mean of the weights is taken. They are stored as float16 and computed with in float32: half the size, and
the same speed on any CPU. The size of the batch, the input's height and width, multiples of 32, stay open.
"""

from __future__ import annotations

import argparse
import hashlib
import io
from pathlib import Path

import numpy as np
import onnx
import torch
from onnx import helper, numpy_helper

from polarmap.prior.polarization_input import CHANNELS
from polarmap.prior.polarization_network import PIXELS
from training.network import OUTPUTS, PolarNet

_SMALL = 64  # values; smaller tensors stay float32


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("checkpoint", type=Path)
    parser.add_argument("out", type=Path)
    arguments = parser.parse_args()
    export(*load(arguments.checkpoint), arguments.out)
    print_file(arguments.out)


def print_file(path: Path) -> None:
    """Its size and checksum, as the model card states them."""
    content = path.read_bytes()
    print(f"{path}: {len(content) / 1e6:.2f} MB, sha256 {hashlib.sha256(content).hexdigest()}")


def load(checkpoint: Path) -> tuple[PolarNet, tuple[int, int]]:
    """The network with the running mean of a checkpoint's weights, and the (height, width) it was trained at last."""
    state = torch.load(checkpoint, weights_only=True)
    network = PolarNet()
    network.load_state_dict(state["mean"])
    return network.eval(), state["size"]


def export(network: PolarNet, size: tuple[int, int], path: Path) -> None:
    """As ONNX with float16 weights, which says how many pixels its input should have."""
    buffer = io.BytesIO()
    open_sides = {0: "batch", 2: "height", 3: "width"}
    torch.onnx.export(
        network.eval(),
        torch.zeros(1, CHANNELS, *size),
        buffer,
        input_names=["input"],
        output_names=list(OUTPUTS),
        dynamic_axes={"input": open_sides, **{name: {0: "batch", 2: "h", 3: "w"} for name in OUTPUTS}},
        opset_version=17,
        dynamo=False,
    )
    model = onnx.load_from_string(buffer.getvalue())
    _halve(model.graph)
    helper.set_model_props(model, {PIXELS: str(size[0] * size[1])})
    onnx.checker.check_model(model)
    onnx.save(model, str(path))


def _halve(graph: onnx.GraphProto) -> None:
    """Weights as float16, each followed by a cast that ONNX Runtime carries out once, when it loads the file."""
    casts = []
    for tensor in graph.initializer:
        values = numpy_helper.to_array(tensor)
        if values.dtype != np.float32 or values.size < _SMALL:
            continue
        name = tensor.name
        tensor.CopyFrom(numpy_helper.from_array(values.astype(np.float16), name + ".half"))
        casts.append(helper.make_node("Cast", [name + ".half"], [name], to=onnx.TensorProto.FLOAT))
    for cast in reversed(casts):
        graph.node.insert(0, cast)


if __name__ == "__main__":
    main()
