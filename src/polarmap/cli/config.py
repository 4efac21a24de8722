"""polarmap config: every parameter."""

from __future__ import annotations

from typing import Annotated

import typer
from rich.table import Table

from polarmap.cli.common import ConfigPath, Settings, console, read_parameters


def show_config(
    config: ConfigPath = None,
    settings: Settings = None,
    as_yaml: Annotated[bool, typer.Option("--yaml", help="As a file for --config.")] = False,
) -> None:
    """List every parameter with its value, unit, meaning, and the paper's section it comes from.

    Example: polarmap config --yaml > config.yaml
    """
    parameters = read_parameters(config, settings)
    if as_yaml:
        typer.echo(parameters.to_yaml(), nl=False)
        return
    table = Table("parameter", "value", "unit", "meaning", "paper", highlight=False)
    for entry in parameters.parameters():
        value = "auto" if entry.value is None else str(entry.value)
        changed = "" if entry.value == entry.default else "bold"
        name = f"{entry.section}.{entry.name}"
        table.add_row(name, value, entry.unit, entry.meaning, entry.source, style=changed)
    console.print(table)
