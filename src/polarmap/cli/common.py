"""What several commands share: consoles, options and what is read by them, progress bars, interruptions."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from polarmap.errors import PolarmapError, concise
from polarmap.interrupts import EndRequests, StopRequests, say_at_once

if TYPE_CHECKING:
    from polarmap.cli.compile_notice import CompileNotice
    from polarmap.data.camera_file import CameraFile
    from polarmap.pipeline.config import Config

console = Console(emoji=False)  # paths and messages may hold ":B:" and the like
messages = Console(stderr=True, emoji=False)

SequencePath = Annotated[Path, typer.Argument(metavar="SEQUENCE", help="Folder of a recording (docs/formats.md).")]
RecordingPath = Annotated[
    Path, typer.Argument(metavar="SEQUENCE", help="Folder of a recording (docs/formats.md), or ROS bag (docs/bags.md).")
]
CameraPath = Annotated[
    Path | None,
    typer.Option(
        "--camera",
        help="Camera file to use in place of SEQUENCE/camera.yaml, or a calibration by OpenCV, ROS, Kalibr and others.",
        metavar="FILE",
    ),
]
ConfigPath = Annotated[
    Path | None, typer.Option("--config", help="Parameters in YAML; see 'polarmap config'.", metavar="FILE")
]
Settings = Annotated[
    list[str] | None,
    typer.Option("--set", help="One parameter, such as surfaces.cells=4800; may be repeated.", metavar="A.B=C"),
]
PriorName = Annotated[
    str,
    typer.Option("--prior", help="'polarnet', 'sparse', or a relative depth network as an ONNX file (docs/priors.md)."),
]
Force = Annotated[bool, typer.Option("--force", help="Write into OUT even if it is not empty.")]
Out = Annotated[Path, typer.Option("--out", help="Folder to write.", metavar="OUT")]


class Interrupted(PolarmapError):
    """The user stopped the program; the exit status is that of the signal, `interrupts.stopped_status`."""

    exit_status = 130


def warn(message: str) -> None:
    """A warning on stderr, in one line."""
    line = f"warning: {concise(' '.join(message.split()))}"
    messages.print(line, style="yellow", markup=False, highlight=False, soft_wrap=True)


class WarningLines(logging.Handler):
    """Shows what the library logs, a line each."""

    def emit(self, record: logging.LogRecord) -> None:
        with suppress(OSError):  # the terminal has gone
            warn(record.getMessage())


def read_parameters(config: Path | None, settings: list[str] | None) -> Config:
    """The parameters of --config, or the defaults, with those of --set."""
    from polarmap.pipeline.config import Config, read_config

    parameters = read_config(config) if config is not None else Config()
    return parameters.with_settings(settings) if settings else parameters


def read_camera(path: Path | None, sequence: Path) -> CameraFile | None:
    """The camera file of --camera; None where it is not given."""
    from polarmap.io.recording.camera_file import read_camera_file

    return None if path is None else read_camera_file(path, sequence)


@contextmanager
def rendering(out: Path, frames: int) -> Iterator[Callable[[], None]]:
    """While a sequence is made: gives what to call after each frame. Ctrl-C says what is left of it."""
    try:
        with progress_bar() as progress:
            task = progress.add_task("rendering", total=frames)
            yield lambda: progress.advance(task)
    except KeyboardInterrupt:
        raise Interrupted(f"interrupted; {out} is incomplete, make it anew with --force") from None


def stop_requests() -> StopRequests:
    """Stop requests that tell the user what happens now."""
    return StopRequests(_tell)


def end_requests() -> EndRequests:
    """Requests to end what has no end of its own, which tell the user what happens now."""
    return EndRequests(_tell)


def _tell(requests: int) -> None:
    say_at_once("\nstopping; what is done is written first" if requests == 1 else "\nonce more to quit at once")


def progress_bar() -> Progress:
    """A progress bar on stderr, gone when it is done; nothing where that is no terminal."""
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    return Progress(*columns, console=messages, transient=True, disable=not messages.is_terminal)


def compile_notice(
    text: str = "Compiling for this machine; that takes some minutes and is kept for later runs.",
) -> CompileNotice:
    """While something is computed: tells the user once if that has to be compiled first."""
    from polarmap.cli.compile_notice import CompileNotice

    return CompileNotice(lambda: messages.print(text, soft_wrap=True))
