"""Average the weights of two exported networks, one of which was trained from the other.

    python -m training.average RUN/polarnet.onnx src/polarmap/prior/polarnet.onnx OUT.onnx --share 0.75

A network that was trained on from another one is better at what it was trained on last, and a little of what it knew
is lost; between the two the loss is low all the way (Wortsman et al. 2022, "Robust fine-tuning of zero-shot models"),
and pictures of another kind than those of training gain. The size of input is the first one's.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import onnx
from onnx import numpy_helper

from training.export import print_file


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("first", type=Path, help="written by training.export")
    parser.add_argument("second", type=Path, help="the one that its training started from")
    parser.add_argument("out", type=Path)
    parser.add_argument("--share", type=float, default=0.75, help="of the first in the mean (0.75)")
    arguments = parser.parse_args()
    average(arguments.first, arguments.second, arguments.out, arguments.share)
    print_file(arguments.out)


def average(first: Path, second: Path, out: Path, share: float) -> None:
    """Write the mean of all weights. ValueError where the files are not of the same network."""
    model, other = onnx.load(str(first)), onnx.load(str(second))
    weights = {tensor.name: numpy_helper.to_array(tensor) for tensor in other.graph.initializer}
    for tensor in model.graph.initializer:
        values, others = numpy_helper.to_array(tensor), weights.get(tensor.name)
        if others is None or others.shape != values.shape or others.dtype != values.dtype:
            raise ValueError(f"{second}: has no weights '{tensor.name}' of {first}'s shape")
        if values.dtype.kind == "f":
            mean = share * values.astype(np.float32) + (1.0 - share) * others.astype(np.float32)
            tensor.CopyFrom(numpy_helper.from_array(mean.astype(values.dtype), tensor.name))
    onnx.save(model, str(out))


if __name__ == "__main__":
    main()
