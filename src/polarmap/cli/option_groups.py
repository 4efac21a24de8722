"""Options that several commands share, as one parameter: a dataclass with a field for each."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import MISSING, fields, is_dataclass
from functools import wraps
from typing import get_type_hints


def with_option_groups(command: Callable[..., None]) -> Callable[..., None]:
    """The command with an option for each field of a parameter that is a dataclass; typer has no groups of its own.

    A field without a default is an option that must be given.
    """
    parameters: dict[str, inspect.Parameter] = {}
    groups: dict[str, type] = {}
    for name, parameter in inspect.signature(command, eval_str=True).parameters.items():
        if is_dataclass(parameter.annotation):
            groups[name] = parameter.annotation
            parameters |= _options_of(parameter.annotation)
        else:
            parameters[name] = parameter.replace(kind=inspect.Parameter.KEYWORD_ONLY)

    @wraps(command)
    def ungrouped(**values: object) -> None:
        for name, group in groups.items():
            values[name] = group(**{field.name: values.pop(field.name) for field in fields(group)})
        command(**values)

    ungrouped.__signature__ = inspect.Signature([*parameters.values()])
    ungrouped.__annotations__ = {name: parameter.annotation for name, parameter in parameters.items()}
    return ungrouped


def _options_of(group: type) -> dict[str, inspect.Parameter]:
    hints, kind = get_type_hints(group, include_extras=True), inspect.Parameter.KEYWORD_ONLY
    empty = inspect.Parameter.empty
    defaults = {field.name: empty if field.default is MISSING else field.default for field in fields(group)}
    return {
        name: inspect.Parameter(name, kind, default=default, annotation=hints[name])
        for name, default in defaults.items()
    }
