"""Start from the weights of an exported network, whose file holds each batch normalization folded into its convolution.

The normalizations are put back: their statistics are measured on a batch of examples, and their scale and offset
chosen so that the network does what the file does. Filters get norm 1, which the normalization after them undoes, so
that a rate of learning means the same for all of them.
"""

from __future__ import annotations

from pathlib import Path

import onnx
import torch
from onnx import numpy_helper
from torch import nn


@torch.no_grad()
def warm_start(network: nn.Module, path: Path, examples: torch.Tensor) -> None:
    """Give a network the weights of an ONNX file made by `training.export`. examples: B×6×H×W, some dozens.

    The network is left in evaluation mode. ValueError where the file is that of a network of another shape.
    """
    network.eval()
    graph = onnx.load(str(path)).graph
    stored = _stored(graph)
    own = network.state_dict()
    for name in stored.keys() & own.keys():  # what export has not folded
        _copy(own[name], stored[name], path)
    folded = []
    layers, nodes = _in_order(network, examples), [node for node in graph.node if node.op_type == "Conv"]
    if len(layers) != len(nodes):
        raise ValueError(f"{path}: holds {len(nodes)} convolutions, the network has {len(layers)}")
    for (convolution, normalization), node in zip(layers, nodes, strict=True):
        if normalization is None:
            continue
        weight, bias = (stored[name] for name in node.input[1:])
        _copy(convolution.weight, weight, path)
        normalization.reset_running_stats()
        normalization.weight.fill_((1.0 + normalization.eps) ** 0.5)
        normalization.bias.copy_(bias)
        folded.append((convolution, normalization))
    _unfold(network, folded, examples)


def _copy(target: torch.Tensor, value: torch.Tensor, path: Path) -> None:
    if target.shape != value.shape:
        raise ValueError(f"{path}: weights of shape {tuple(value.shape)} where the network has {tuple(target.shape)}")
    target.copy_(value)


def _in_order(network: nn.Module, examples: torch.Tensor) -> list[tuple[nn.Conv2d, nn.BatchNorm2d | None]]:
    """The convolutions as they are run, each with the normalization that follows if it has no bias of its own."""
    seen: list[nn.Module] = []
    kinds = (nn.Conv2d, nn.BatchNorm2d)
    hooks = [m.register_forward_hook(lambda m, *_: seen.append(m)) for m in network.modules() if isinstance(m, kinds)]
    network(examples[:1])
    for hook in hooks:
        hook.remove()
    following = [*seen[1:], None]
    return [
        (m, n if m.bias is None else None) for m, n in zip(seen, following, strict=True) if isinstance(m, nn.Conv2d)
    ]


def _stored(graph: onnx.GraphProto) -> dict[str, torch.Tensor]:
    """All stored tensors, those stored as half as float32 under the name that the graph uses."""
    return {
        t.name.removesuffix(".half"): torch.from_numpy(numpy_helper.to_array(t).copy()).float()
        for t in graph.initializer
    }


def _unfold(network: nn.Module, folded: list[tuple[nn.Conv2d, nn.BatchNorm2d]], examples: torch.Tensor) -> None:
    statistics = {}

    def measure(module: nn.Module, inputs: tuple[torch.Tensor, ...]) -> None:
        statistics[module] = torch.var_mean(inputs[0], dim=(0, 2, 3))

    hooks = [normalization.register_forward_pre_hook(measure) for _, normalization in folded]
    network(examples)
    for hook in hooks:
        hook.remove()
    for convolution, normalization in folded:
        variance, mean = statistics[normalization]
        norm = convolution.weight.flatten(1).norm(dim=1).clamp(min=1e-6)
        convolution.weight.div_(norm.view(-1, 1, 1, 1))
        normalization.running_mean.copy_(mean / norm)
        normalization.running_var.copy_(variance / norm.square())
        normalization.weight.copy_(norm * (normalization.running_var + normalization.eps).sqrt())
        normalization.bias.add_(mean)
