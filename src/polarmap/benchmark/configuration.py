"""All that the figures of a cell depend on, so that a cell is run again when, and only when, some of it changed."""

from __future__ import annotations

import hashlib
import os
from pathlib import Path
from typing import Any

from polarmap.benchmark.cells import Cell
from polarmap.benchmark.spec import ImportMethod, MappingMethod, SequenceSpec
from polarmap.errors import InputError
from polarmap.io.files import open_input, reason
from polarmap.io.recording.camera_file import CAMERA_FILE_NAME
from polarmap.pipeline.config import Config
from polarmap.prior.names import BUILT_IN, POLARNET, SPARSE
from polarmap.prior.polarization_network import WEIGHTS

_TEXTS = (CAMERA_FILE_NAME, "timestamps.txt", "groundtruth.txt")
_CHUNK = 1 << 20
_MOST_BYTES = 1 << 34  # of a file whose content is not kept, such as a network


def configuration(cell: Cell) -> dict[str, Any]:
    """As JSON has it. Raises InputError where a file that it depends on is missing, or a setting is wrong."""
    method = cell.method
    state = _import_state(cell) if isinstance(method, ImportMethod) else _mapping_state(method, cell.seed)
    return {"sequence": _sequence_state(cell.sequence, cell.seed), "method": state}


def parameters(method: MappingMethod) -> Config:
    """The parameters that a method maps with. Raises InputError where a setting is wrong."""
    try:
        return Config().with_settings(method.settings) if method.settings else Config()
    except InputError as error:
        raise InputError(f"method {method.name}: settings: {str(error).removeprefix('--set: ')}") from None


def import_path(cell: Cell) -> Path:
    """Where another program's results of this cell are."""
    return Path(cell.method.path.replace("{sequence}", cell.sequence.name).replace("{seed}", str(cell.seed)))


def _sequence_state(sequence: SequenceSpec, seed: int) -> dict[str, Any]:
    state: dict[str, Any] = {"frames": sequence.frames}
    if sequence.camera is not None:
        state["camera"] = _digest(Path(sequence.camera))
    if sequence.path is None:
        return {**state, "synth": sequence.synth_arguments, "seed": seed}
    folder = Path(sequence.path)
    if not os.path.isdir(folder):
        raise InputError(f"sequence {sequence.name}: {folder}: no such folder; correct its path in the spec")
    texts = {name: _digest(folder / name) for name in _TEXTS if os.path.exists(folder / name)}
    return {**state, **texts, "files": _listing(folder)}


def _mapping_state(method: MappingMethod, seed: int) -> dict[str, Any]:
    return {
        "kind": "polarmap",
        "poses": method.poses,
        "odometry_seed": seed if method.poses == "odometry" else None,
        "prior": _prior_state(method),
        "parameters": parameters(method).model_dump(mode="json"),
    }


def _prior_state(method: MappingMethod) -> str:
    if method.prior == SPARSE:
        return SPARSE
    if method.prior == POLARNET:
        return f"{POLARNET} {_digest(WEIGHTS)}"
    if not os.path.isfile(method.prior):
        built_in = ", ".join(BUILT_IN)
        raise InputError(
            f"method {method.name}: {method.prior}: no such file; prior must be {built_in} or an ONNX file"
        )
    return _digest(Path(method.prior))


def _import_state(cell: Cell) -> dict[str, Any]:
    method, path = cell.method, import_path(cell)
    if not os.path.exists(path):
        raise InputError(f"{path}: no such file or folder; put the results of {cell.name} there")
    rules = method.model_dump(mode="json", include={"kind", "format", "scale", "depth_scale"})
    return {**rules, "files": _listing(path, times=True)}


def _digest(path: Path) -> str:
    """SHA-256 of a file's content."""
    digest = hashlib.sha256()
    with open_input(path, _MOST_BYTES) as file:
        while chunk := file.read(_CHUNK):
            digest.update(chunk)
    return digest.hexdigest()


def _listing(path: Path, times: bool = False) -> str:
    """SHA-256 of the names and sizes, with `times` the times of change too, of all files in a folder."""
    digest = hashlib.sha256()
    files = [path] if os.path.isfile(path) else sorted(Path(f, name) for f, _, names in os.walk(path) for name in names)
    for file in files:
        try:
            status = file.stat()
        except OSError as error:
            raise InputError(f"{file}: cannot be read ({reason(error)})") from None
        time = status.st_mtime_ns if times else 0
        digest.update(
            f"{file.relative_to(path).as_posix()} {status.st_size} {time}\n".encode("utf-8", "surrogateescape")
        )
    return digest.hexdigest()
