"""What a depth network wants to see and what it gives: declared in a sidecar file or known by the model's name."""

from __future__ import annotations

import os
import re
from enum import Enum
from pathlib import Path
from typing import Annotated

from pydantic import Field

from polarmap.errors import InputError
from polarmap.io.formats.yaml_text import read_yaml
from polarmap.options import Options, parameter

_MAX_SIDECAR_BYTES = 100_000
_IMAGENET = {"mean": (0.485, 0.456, 0.406), "std": (0.229, 0.224, 0.225)}
_HALF = {"mean": (0.5, 0.5, 0.5), "std": (0.5, 0.5, 0.5)}

Mean = Annotated[float, Field(ge=-1e4, le=1e4)]
Deviation = Annotated[float, Field(ge=1e-4, le=1e4)]
Index = Annotated[int, Field(ge=0, le=1000)]
Side = Annotated[int, Field(ge=16, le=4096)]


class OutputSpace(str, Enum):
    """What a network's output grows with."""

    INVERSE_DEPTH = "inverse depth"  # also called disparity; near is large
    DEPTH = "depth"
    LOG_DEPTH = "log depth"


class NetworkSpec(Options):
    """How to feed a relative depth network and read it.

    A pixel's encoded intensity e in [0, 1] becomes full_scale · (e - mean) / std in each channel. The image is grey:
    RGB and BGR differ in the order of `mean` and `std` alone.
    """

    output_space: OutputSpace = parameter(..., "'inverse depth', 'depth' or 'log depth'")
    input_size: tuple[Side, Side] | None = parameter(
        None, "height and width where the model leaves them open; the shorter is kept, the longer fits the image"
    )
    multiple_of: int = parameter(32, "sides of an open input are multiples of this", "pixels", ge=1, le=512)
    mean: tuple[Mean, Mean, Mean] = parameter(
        (0.0, 0.0, 0.0), "subtracted from encoded intensity, per channel of the input"
    )
    std: tuple[Deviation, Deviation, Deviation] = parameter((1.0, 1.0, 1.0), "divides it, per channel of the input")
    full_scale: float = parameter(1.0, "what white is without mean and std: 1 or 255", ge=1e-3, le=1e6)
    gamma: float = parameter(0.45, "linear intensities are encoded by this power; 0.45 is close to sRGB", ge=0.01, le=1)
    output: Index | str = parameter(0, "index or name of the output to read")


# Sources: the makers' preprocessing. MiDaS's own ONNX files (make_onnx_model.py) and the usual conversions of v2.1
# normalize inside the graph; exports of the bare networks do not. Metric3D's exporter puts normalization into the
# graph, for values up to 255. Metric Depth Anything V2 is named by where it is for, or by what it was trained on.
_KNOWN: tuple[tuple[str, dict], ...] = (
    (r"tc_?monodepth", {"full_scale": 255.0}),
    (
        r"(depth[-_]?anything[-_]?(v?3|.*da3)|(^|[-_])da3)",
        {"output_space": "depth", "input_size": (504, 504), "multiple_of": 14, **_IMAGENET},
    ),
    (
        r"depth[-_]?anything.*(metric|indoor|outdoor|hypersim|v?kitti|nyu)",
        {"output_space": "depth", "input_size": (518, 518), "multiple_of": 14, **_IMAGENET},
    ),
    (r"distill[-_]?any[-_]?depth", {"input_size": (518, 518), "multiple_of": 14, **_IMAGENET}),
    (r"depth[-_]?anything", {"input_size": (518, 518), "multiple_of": 14, **_IMAGENET}),
    (r"metric[-_]?3d", {"output_space": "depth", "input_size": (616, 1064), "multiple_of": 28, "full_scale": 255.0}),
    (r"uni[-_]?depth", {"output_space": "depth", "input_size": (462, 616), "multiple_of": 14, **_IMAGENET}),
    (r"zoe[-_]?d", {"output_space": "depth", "input_size": (384, 512), **_HALF}),
    (r"depth[-_]?pro", {"output_space": "depth", "input_size": (1536, 1536), "multiple_of": 512, **_HALF}),
    (r"glpn", {"output_space": "depth", "input_size": (480, 640)}),
    (r"marigold", {"output_space": "depth", "input_size": (576, 768), "multiple_of": 8, **_HALF}),
    (r"leres", {"output_space": "depth", "input_size": (448, 448), **_IMAGENET}),
    (r"dpt[-_]", {"input_size": (384, 384), **_HALF}),
    (r"model-small", {"input_size": (256, 256)}),
    (r"model-f(6b98070|46da743)", {"input_size": (384, 384)}),
    (r"midas[-_]?v2[-_.]?1", {"input_size": (384, 384)}),
    (r"midas", {"input_size": (384, 384), **_IMAGENET}),
)


def network_spec(model: Path) -> NetworkSpec:
    """The specification of MODEL.onnx: that of its sidecar MODEL.yaml, or one known by the file's name.

    What a sidecar does not say is as the name has it, except for the output space, which it must say.
    Raises InputError where there is neither or the sidecar is malformed.
    """
    sidecar, known = model.with_suffix(".yaml"), _known(model)
    if is_declared(model):
        return _read_sidecar(sidecar, known or {})
    if known is not None:
        return NetworkSpec(**{"output_space": "inverse depth", **known})
    raise InputError(
        f"{model}: not a network known by name; describe it in {sidecar}, at least 'output_space: inverse depth' "
        "(or depth, or log depth), with mean, std and full_scale as it was trained"
    )


def is_declared(model: Path) -> bool:
    """Whether a sidecar describes MODEL.onnx; else it is known by its name, if at all."""
    return os.path.lexists(model.with_suffix(".yaml"))


def _known(model: Path) -> dict | None:
    """Parameters known by the file's name, None where it says nothing."""
    name = model.stem.lower()
    return next((values for pattern, values in _KNOWN if re.search(pattern, name)), None)


def _read_sidecar(path: Path, known: dict) -> NetworkSpec:
    values = read_yaml(path, _MAX_SIDECAR_BYTES)
    if not isinstance(values, dict) or not all(isinstance(key, str) for key in values):
        raise InputError(f"{path}: must map names to values, such as 'output_space: inverse depth'")
    try:
        return NetworkSpec(**{name: value for name, value in known.items() if name != "output_space"} | values)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
