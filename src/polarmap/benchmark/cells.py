"""The cells of a benchmark, one sequence mapped by one method with one seed, and what each leaves in its folder."""

from __future__ import annotations

import fnmatch
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, ValidationError

from polarmap.benchmark.spec import ImportMethod, MappingMethod, SequenceSpec, Spec
from polarmap.errors import InputError
from polarmap.io.files import write_bytes
from polarmap.io.formats.json_text import read_json_text
from polarmap.io.run_folder.results import StepTime

RESULT_NAME = "result.json"

CellKey = tuple[str, str, int]
"""Names of sequence and method, and the seed."""

Number = Annotated[float, BeforeValidator(lambda value: float("nan") if value is None else value)]


@dataclass(frozen=True)
class Cell:
    """One sequence, method and seed of a benchmark."""

    sequence: SequenceSpec
    method: MappingMethod | ImportMethod
    seed: int

    @property
    def key(self) -> CellKey:
        """What its result is found by."""
        return self.sequence.name, self.method.name, self.seed

    @property
    def name(self) -> str:
        """What messages call it."""
        return f"{self.sequence.name}/{self.method.name}, seed {self.seed}"

    def folder(self, out: Path) -> Path:
        """Where it is kept in the benchmark's folder."""
        return out / "cells" / self.sequence.name / self.method.name / f"seed{self.seed}"


class _Record(BaseModel):
    model_config = ConfigDict(frozen=True, ser_json_inf_nan="null")


class Curve(_Record):
    """y against x, of the same length; NaN where nothing could be measured."""

    x: list[Number]
    y: list[Number]


class CellResult(_Record):
    """The content of result.json.

    configuration: all that the figures depend on; a cell is not run again as long as it is the same.
    reason: why it failed. started: UTC. seconds: wall time of the cell.
    keyframes: indices of the frames that were compared.
    figures: every figure of the evaluation by its path in it, such as "depth.abs_rel", and those of the run under
    "run."; NaN where nothing could be measured. curves: by name. notes: what the reader of the figures must know.
    milliseconds: of the run, by step.
    versions, machine, processor, cpu_count: what it was run with.
    """

    status: Literal["complete", "failed"]
    sequence: str
    method: str
    seed: int
    configuration: dict[str, Any]
    reason: str | None = None
    started: str
    seconds: float
    keyframes: list[int] = []
    figures: dict[str, Number] = {}
    curves: dict[str, Curve] = {}
    notes: list[str] = []
    milliseconds: dict[str, StepTime] = {}
    versions: dict[str, str] = {}
    machine: str = ""
    processor: str = ""
    cpu_count: int | None = None


def cells_of(spec: Spec) -> list[Cell]:
    """All cells, sequence by sequence. Where no seed plays a part there is only that of the first."""
    return [
        Cell(sequence, method, seed)
        for sequence in spec.sequences
        for seed_place, seed in enumerate(spec.seeds)
        for method in spec.methods
        if seed_place == 0 or _seeded(sequence, method)
    ]


def select(cells: list[Cell], only: list[str]) -> list[Cell]:
    """Those that one of the SEQUENCE/METHOD patterns names, * standing for any; all where there is no pattern.

    Raises InputError where a pattern names none.
    """
    if not only:
        return cells
    for pattern in only:
        if not any(_named(cell, pattern) for cell in cells):
            pairs = dict.fromkeys(f"{cell.sequence.name}/{cell.method.name}" for cell in cells)
            raise InputError(f"--only {pattern}: there is no such SEQUENCE/METHOD; known are {', '.join(pairs)}")
    return [cell for cell in cells if any(_named(cell, pattern) for pattern in only)]


def write_result(folder: Path, result: CellResult) -> None:
    """Write result.json; PolarmapError where that fails."""
    write_bytes(folder / RESULT_NAME, (result.model_dump_json(indent=1) + "\n").encode())


def read_result(folder: Path) -> CellResult | None:
    """The result in a cell's folder; None where there is none, or none that can be read."""
    path = folder / RESULT_NAME
    if not path.exists():
        return None
    try:
        return CellResult.model_validate_json(read_json_text(path), strict=True)
    except (ValidationError, InputError):
        return None


def _seeded(sequence: SequenceSpec, method: MappingMethod | ImportMethod) -> bool:
    if isinstance(method, ImportMethod):
        return method.by_seed
    return sequence.synth is not None or method.poses == "odometry"


def _named(cell: Cell, pattern: str) -> bool:
    sequence, _, method = pattern.partition("/")
    return fnmatch.fnmatchcase(cell.sequence.name, sequence) and fnmatch.fnmatchcase(cell.method.name, method or "*")
