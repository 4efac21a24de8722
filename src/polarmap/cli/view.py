"""polarmap view: a finished run in the browser; and the page of one that goes on."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from time import sleep
from typing import TYPE_CHECKING, Annotated

import numpy as np
import typer

from polarmap.cli.common import console, progress_bar
from polarmap.errors import InputError

if TYPE_CHECKING:
    from polarmap.viewer.page import Page
    from polarmap.viewer.watcher import Watcher

_PAUSE = 0.1  # seconds between two looks at what was asked for
DEFAULT_AT = "127.0.0.1:8080"

View = Annotated[bool, typer.Option("--view", help="Show the map in the browser while it grows (docs/viewing.md).")]
ViewAt = Annotated[
    str, typer.Option("--view-at", help="Where the page is; 0.0.0.0:8080 shows it to other machines too.", metavar="AT")
]


def view(
    run: Annotated[Path, typer.Argument(help="Folder that 'polarmap run' has written.", metavar="MAP")],
    at: ViewAt = DEFAULT_AT,
) -> None:
    """Show a finished run in the browser: the mesh, and each keyframe's surface and pictures.

    Example: polarmap view out
    """
    from polarmap.export.source import open_map
    from polarmap.viewer.stored import MOST_KEYFRAMES, stored_patches

    source = open_map(run)
    with _page(at, f"polarmap: {run.name}") as page:
        with progress_bar() as progress:
            task = progress.add_task("reading", total=min(len(source.files), MOST_KEYFRAMES))
            for patch in stored_patches(source):
                page.add(patch)
                progress.advance(task)
            if source.mesh_path.exists():
                page.show_mesh(source.mesh(), np.zeros(3))
        page.say("")
        _wait(page)


@contextmanager
def watched(shown: bool, at: str) -> Iterator[Watcher | None]:
    """The watcher of a run, None if it is not to be `shown`; in a terminal its page stays after it, until Ctrl-C."""
    if not shown:
        yield None
        return
    from polarmap.viewer.feed import Feed

    with _page(at, "polarmap") as page:
        with Feed(page) as feed:
            yield feed
        if console.is_terminal:
            _wait(page)


@contextmanager
def _page(at: str, title: str) -> Iterator[Page]:
    from polarmap.viewer.page import Page

    page = Page(*_address(at), title)
    try:
        console.print(f"the map is at {page.address}", markup=False, highlight=False, soft_wrap=True)
        yield page
    finally:
        page.close()


def _wait(page: Page) -> None:
    console.print("Ctrl-C ends the page", markup=False, highlight=False)
    try:
        while True:
            page.refresh()
            sleep(_PAUSE)
    except KeyboardInterrupt:
        return


def _address(at: str) -> tuple[str, int]:
    host, colon, port = at.rpartition(":")
    if not colon or not host or not port.isdigit() or not 0 < int(port) < 65536:
        raise InputError(f"--view-at {at}: give it as HOST:PORT, such as {DEFAULT_AT}")
    return host, int(port)
