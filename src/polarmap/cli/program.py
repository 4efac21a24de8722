"""The program: its commands, and how it ends whatever happens."""

from __future__ import annotations

import errno
import logging
import os
import sys
from contextlib import suppress
from typing import Annotated

import typer

from polarmap.cli.bench import bench
from polarmap.cli.calibrate import calibrate
from polarmap.cli.camera import camera
from polarmap.cli.common import Interrupted, WarningLines, messages
from polarmap.cli.config import show_config
from polarmap.cli.demo import demo
from polarmap.cli.evaluate import evaluate
from polarmap.cli.export import export
from polarmap.cli.inspect import inspect
from polarmap.cli.live import live
from polarmap.cli.odometry import odometry
from polarmap.cli.record import record
from polarmap.cli.run import run
from polarmap.cli.streams import make_streams_tolerant
from polarmap.cli.synth.program import synth_app
from polarmap.cli.view import view
from polarmap.cli.warm_up import warm_up
from polarmap.errors import PolarmapError, concise
from polarmap.interrupts import raise_stopped, stopped_status, was_stopped
from polarmap.version import package_version

# Commands import what they use when they are called, so that --help and `config` answer at once.

app = typer.Typer(
    help="Dense maps from a moving polarization camera.",
    epilog="Start with 'polarmap demo --out demo', then 'polarmap inspect' on your own recording.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="markdown",
)
app.command()(run)
app.command()(live)
app.command()(record)
app.command()(odometry)
app.command("eval")(evaluate)
app.command()(export)
app.command()(bench)
app.command()(inspect)
app.command()(camera)
app.command()(calibrate)
app.command("config")(show_config)
app.command()(demo)
app.command()(view)
app.command("warmup")(warm_up)
app.add_typer(synth_app, name="synth")


def _tell_version(asked: bool) -> None:
    if asked:
        typer.echo(f"polarmap {package_version() or '(of no known version: it is not installed)'}")
        raise typer.Exit


@app.callback()
def options(
    version: Annotated[
        bool, typer.Option("--version", help="Show the version and exit.", callback=_tell_version, is_eager=True)
    ] = False,
) -> None:
    """What may stand before a command."""


def main() -> None:
    """Entry point: errors in one line on stderr; exit status 2 for bad input, 1 for a failure, 128 + signal."""
    make_streams_tolerant()
    raise_stopped()
    logging.basicConfig(level=logging.WARNING, handlers=[WarningLines()])
    sys.exit(_status())


def _status() -> int:
    try:
        app()
    except Interrupted as stopped:
        return _fail(str(stopped), stopped_status())
    except PolarmapError as error:
        return _fail(str(error), error.exit_status)
    except KeyboardInterrupt:
        return _fail("interrupted", stopped_status())
    except SystemExit as ended:
        if ended.code != Interrupted.exit_status:
            raise
        return _fail("interrupted", stopped_status())  # Ctrl-C before or after the work proper
    except MemoryError:
        return _fail("out of memory; try a larger fusion.voxel_size or smaller images", 1)
    except BrokenPipeError:  # whoever read the output has gone, such as 'head'
        _discard_output()
        return 1
    except OSError as error:
        if was_stopped():  # with the terminal, say
            return stopped_status()
        hint = "free some space there" if error.errno == errno.ENOSPC else "check that it exists and may be used"
        return _fail(f"{error.filename or 'output'}: {error.strerror}; {hint}", 1)
    return 0


def _fail(message: str, status: int) -> int:
    line = f"polarmap: {concise(' '.join(message.split()))}"
    with suppress(OSError):  # the terminal has gone
        messages.print(line, style="red", markup=False, highlight=False, soft_wrap=True)
    return status


def _discard_output() -> None:
    """Let nothing more be written to stdout when Python ends."""
    with suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
