"""What a benchmark is made of, read from a YAML file: sequences, methods, seeds and tables (docs/benchmark.md)."""

from __future__ import annotations

import os
import re
import shlex
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Discriminator,
    Field,
    Tag,
    ValidationError,
    field_validator,
    model_validator,
)

from polarmap.benchmark import published
from polarmap.errors import InputError
from polarmap.io.formats.yaml_text import read_yaml
from polarmap.prior.names import BUILT_IN, DEFAULT_PRIOR

MAX_SPEC_BYTES = 1 << 20
TABLES = ("accuracy", "ablation", "points", "wall", "figures", "confidence")

_NAME = r"^[A-Za-z0-9][A-Za-z0-9._-]{0,63}$"
_VARIABLE = re.compile(r"\$(\w+|\{\w+\})")
_FRAMES = re.compile(r"(-?\d*):(-?\d*)(?::([1-9]\d*))?")

TableName = Literal["accuracy", "ablation", "points", "wall", "figures", "confidence"]
Name = Annotated[str, Field(pattern=_NAME)]


class _Part(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class _Named(_Part):
    name: Name
    title: str = ""

    @property
    def label(self) -> str:
        """What tables call it."""
        return self.title or self.name


class SequenceSpec(_Named):
    """A sequence. path: its folder; or synth: what `polarmap synth` makes it from, for each seed.

    frames: which of them, as A:B:STEP. camera: a camera file in place of its own. published: the one of the paper's
    sequences (`published.SEQUENCES`) that it is. title: for the tables.
    """

    path: str | None = None
    synth: str | list[str] | None = None
    frames: str | None = None
    camera: str | None = None
    published: str | None = None

    @property
    def synth_arguments(self) -> list[str] | None:
        """What follows `polarmap synth`, as it stands in the spec; None for a sequence that exists."""
        return shlex.split(self.synth) if isinstance(self.synth, str) else self.synth

    @property
    def frame_slice(self) -> slice:
        """Which frames, as a slice of the sequence."""
        return _frame_slice(self.frames) if self.frames else slice(None)

    @field_validator("frames", mode="before")
    @classmethod
    def _quoted(cls, value: Any) -> Any:
        if isinstance(value, int):  # YAML reads 10:50 as a number in base 60
            raise ValueError('write it in quotes, such as "10:50:2"')
        if isinstance(value, str):
            _frame_slice(value)
        return value

    @field_validator("published")
    @classmethod
    def _of_the_paper(cls, value: str | None) -> str | None:
        if value is not None and value not in published.SEQUENCES:
            raise ValueError(f"must be one of the paper's sequences: {', '.join(published.SEQUENCES)}")
        return value

    @model_validator(mode="after")
    def _one_source(self) -> SequenceSpec:
        if (self.path is None) == (self.synth is None):
            raise ValueError("needs either path, a sequence's folder, or synth, the arguments of 'polarmap synth'")
        try:
            arguments = self.synth_arguments
        except ValueError as error:
            raise ValueError(f"synth: {error}") from None
        if self.synth is not None and not arguments:
            raise ValueError("synth: must name what 'polarmap synth' makes, such as 'scene corridor --frames 60'")
        if any(argument.split("=")[0] == "--seed" for argument in arguments or ()):
            raise ValueError("synth: leave --seed out; it is one of the benchmark's seeds")
        return self


class MappingMethod(_Named):
    """This program. poses: the sequence's true ones, or found by odometry. prior: "sparse", "polarnet" or an ONNX file.

    settings: parameters as for `polarmap run --set`.
    """

    kind: Literal["polarmap"] = "polarmap"
    poses: Annotated[Literal["true", "odometry"], BeforeValidator(lambda v: "true" if v is True else v)] = "true"
    prior: str = DEFAULT_PRIOR
    settings: list[str] = []


class ImportMethod(_Named):
    """Another program's results. path: where they are, with {sequence} and {seed} for those names.

    format, scale, depth_scale: see `polarmap.evaluation.measure.evaluate_results`. keyframes_of: a method of this
    program, whose keyframes alone are compared.
    """

    kind: Literal["import"]
    path: str
    format: Literal["auto", "polarmap", "colmap", "openmvs", "depth-png", "depth-npy", "ply", "trajectory"] = "auto"
    scale: Literal["auto", "as-is", "trajectory", "median"] = "auto"
    depth_scale: float | None = Field(None, gt=0)
    keyframes_of: str | None = None

    @property
    def by_seed(self) -> bool:
        """Whether it has results for each seed."""
        return "{seed}" in self.path


def _kind(value: Any) -> Any:
    return value.get("kind", "polarmap") if isinstance(value, dict) else getattr(value, "kind", None)


MethodSpec = Annotated[
    Annotated[MappingMethod, Tag("polarmap")] | Annotated[ImportMethod, Tag("import")],
    Discriminator(
        _kind, custom_error_type="kind", custom_error_message="must be a mapping whose kind is polarmap or import"
    ),
]


class Spec(_Part):
    """A benchmark. seeds: of the noise of made sequences, and of odometry. keep: of each cell the whole run, or only
    its figures. tables: which to write."""

    sequences: list[SequenceSpec] = Field(min_length=1)
    methods: list[MethodSpec] = Field(min_length=1)
    seeds: list[Annotated[int, Field(ge=0, lt=2**31, strict=True)]] = Field([0], min_length=1)
    keep: Literal["run", "figures"] = "run"
    tables: list[TableName] = list(TABLES)

    @model_validator(mode="after")
    def _names_differ(self) -> Spec:
        for key in ("sequences", "methods"):
            _differ(key, [part.name.lower() for part in getattr(self, key)])  # folders of some systems know no case
            _differ(key, [part.label for part in getattr(self, key)])
        _differ("seeds", self.seeds)
        return self

    @model_validator(mode="after")
    def _keyframes_come_first(self) -> Spec:
        known: list[str] = []
        for method in self.methods:
            if isinstance(method, MappingMethod):
                known.append(method.name)
            elif method.keyframes_of not in (None, *known):
                other = f"keyframes_of: {method.keyframes_of}"
                raise ValueError(f"methods: {method.name}: {other} is no method of kind polarmap before it")
        return self


_PARTS: dict[str | int, type[BaseModel]] = {
    "sequences": SequenceSpec,
    "polarmap": MappingMethod,
    "import": ImportMethod,
}


def read_spec(path: Path | str) -> Spec:
    """The benchmark in a YAML file. Paths start from its folder, and $NAME in them stands for the environment's.

    All paths of what is returned are absolute. Raises InputError naming the file, the key, and what is expected.
    """
    path = Path(path)
    values = read_yaml(path, MAX_SPEC_BYTES)
    if not isinstance(values, dict):
        raise InputError(f"{path}: must map sequences and methods to lists (docs/benchmark.md)")
    try:
        spec = Spec.model_validate(values)
    except ValidationError as error:
        raise InputError(f"{path}: {_first_problem(error)}") from None
    return _located(spec, path)


def expanded(text: str, source: str) -> str:
    """Text with $NAME and ${NAME} replaced by the environment's; InputError where there is no such variable.

    A relative path in a variable at its start is one of the working directory, as wherever the variable is used.
    """

    def value(match: re.Match) -> str:
        known = os.environ.get(match.group(1).strip("{}"))
        if known is None:
            raise InputError(f"{source}: {match.group()} is not set; set it, or write the path without it")
        is_path = match.start() == 0 and (known.startswith(".") or os.path.exists(known))
        return os.path.abspath(known) if is_path else known

    return _VARIABLE.sub(value, text)


def _located(spec: Spec, path: Path) -> Spec:
    """The same with absolute paths."""
    folder = path.absolute().parent

    def absolute(text: str | None, key: str) -> str | None:
        return None if text is None else os.path.normpath(folder / expanded(text, f"{path}: {key}"))

    sequences = [
        s.model_copy(update={key: absolute(getattr(s, key), f"sequences[{i}].{key}") for key in ("path", "camera")})
        for i, s in enumerate(spec.sequences)
    ]
    methods = []
    for i, method in enumerate(spec.methods):
        key = "prior" if isinstance(method, MappingMethod) else "path"
        if getattr(method, key) not in BUILT_IN:
            method = method.model_copy(update={key: absolute(getattr(method, key), f"methods[{i}].{key}")})
        methods.append(method)
    return spec.model_copy(update={"sequences": sequences, "methods": methods})


def _frame_slice(text: str) -> slice:
    match = _FRAMES.fullmatch(text.strip())
    if match is None:
        raise ValueError('must be A:B or A:B:STEP with STEP from 1, such as "0:300:2"')
    return slice(*(int(number) if number else None for number in match.groups()))


def _differ(key: str, names: list) -> None:
    for name in names:
        if names.count(name) > 1:
            raise ValueError(f"{key}: {name} is there twice; each needs a name of its own")


def _first_problem(error: ValidationError) -> str:
    problem = error.errors()[0]
    parts = problem["loc"]
    where = ""
    for before, part in zip((None, *parts), parts, strict=False):
        if isinstance(before, int) and part in _PARTS:
            continue  # the kind of a method, which is no key
        where += f"[{part}]" if isinstance(part, int) else f".{part}"
    where = where.removeprefix(".")
    prefix = f"{where}: " if where else ""
    if problem["type"] == "missing":
        return f"{prefix}is missing"
    if problem["type"] == "extra_forbidden":
        return f"{prefix}there is no such key; known are {', '.join(_model_at(parts).model_fields)}"
    if problem["type"] == "string_pattern_mismatch":
        return f"{prefix}must be letters, digits, '.', '_' or '-', at most 64, the first a letter or digit"
    message = problem["msg"].removeprefix("Value error, ")
    return f"{prefix}{message[:1].lower()}{message[1:]}"


def _model_at(parts: tuple[str | int, ...]) -> type[BaseModel]:
    return next((_PARTS[part] for part in reversed(parts[:-1]) if part in _PARTS), Spec)
