"""The base of every step's options: immutable, validated, and documented parameter by parameter."""

from __future__ import annotations

import reprlib
from typing import Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from polarmap.errors import InputError


class Options(BaseModel):
    """Parameters of one step. Unknown names and values out of range raise InputError."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    def __init__(self, **values: Any) -> None:
        try:
            super().__init__(**values)
        except ValidationError as error:
            raise InputError(_first_problem(error, type(self))) from None


def parameter(default: Any, meaning: str, unit: str = "", source: str = "", **limits: Any) -> Any:
    """A field of `Options`: its default, what it means, its unit, and the paper's section it comes from.

    limits: pydantic's ge, gt, le, lt.
    """
    return Field(default, description=meaning, json_schema_extra={"unit": unit, "source": source}, **limits)


def _first_problem(error: ValidationError, model: type[Options]) -> str:
    problem = error.errors()[0]
    name = ".".join(str(part) for part in problem["loc"])
    if problem["type"] == "extra_forbidden":
        return f"{name}: there is no such parameter; known are {', '.join(model.model_fields)}"
    message = problem["msg"].removeprefix("Value error, ")
    return f"{name}: {message[:1].lower()}{message[1:]}, got {reprlib.repr(problem['input'])[:60]}".removeprefix(": ")
