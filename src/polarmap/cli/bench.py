"""polarmap bench: sequences × methods × seeds as tables and plots."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeRemainingColumn
from rich.table import Table

from polarmap.cli.common import Interrupted, compile_notice, console, messages, stop_requests
from polarmap.cli.synth_process import run_synth
from polarmap.errors import PolarmapError

_SPEED_PERIOD = 3600.0  # seconds over which the time left is estimated: cells differ
_SUMMARY = ("AbsRel", "density, %", "% within 2 %")


def bench(
    spec: Annotated[Path, typer.Argument(metavar="SPEC", help="What to run, a YAML file (docs/benchmark.md).")],
    out: Annotated[Path, typer.Option("--out", help="Folder of the benchmark.", metavar="DIR")],
    only: Annotated[
        list[str] | None,
        typer.Option("--only", help="Run only these cells, * standing for any; may be repeated.", metavar="SEQ/METHOD"),
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Run cells again that are done.")] = False,
) -> None:
    """Run sequences × methods × seeds and write tables and plots, the paper's own figures beside them.

    What is done with the same configuration is not run again: after an interruption, give the same command. A cell
    that fails is told in the tables and does not stop the rest; the exit status is then 1.

    Example: polarmap bench benchmarks/specs/quick.yaml --out quick
    """
    from polarmap.benchmark.output import PAGE_NAME, write_outputs
    from polarmap.benchmark.runner import Benchmark
    from polarmap.benchmark.spec import read_spec

    notice = compile_notice("Compiling for this machine; that makes the first times too long.")
    with notice, _progress() as progress:
        benchmark = Benchmark(read_spec(spec), spec, out, run_synth, _reporter(progress))
        try:
            results = benchmark.run(only or [], force)
        except KeyboardInterrupt:
            with stop_requests():  # whose second one does not keep the tables from being written
                write_outputs(benchmark.spec, benchmark.results(), out)
            raise Interrupted(f"interrupted; {out} holds what was done until now, the same command goes on") from None
    tables = write_outputs(benchmark.spec, benchmark.results(), out)
    _print_summary(tables)
    console.print(f"tables: {out / PAGE_NAME}", soft_wrap=True)
    failed = sum(result.status == "failed" for result in results.values())
    if failed:
        raise PolarmapError(f"{failed} of {len(results)} cells failed; {out / PAGE_NAME} says why")


def _progress() -> Progress:
    columns = (SpinnerColumn(), TextColumn("{task.description}"), BarColumn(), TextColumn("{task.fields[count]}"))
    return Progress(
        *columns,
        TimeRemainingColumn(),
        console=messages,
        transient=True,
        disable=not messages.is_terminal,
        speed_estimate_period=_SPEED_PERIOD,
    )


def _reporter(progress: Progress):
    from polarmap.benchmark.cells import Cell, CellResult
    from polarmap.benchmark.runner import Watcher

    class Reporter(Watcher):
        """Two bars, of all cells and of the present one, and a line for each cell that is done."""

        def started(self, cells: int) -> None:
            self._cells, self._done, self._frames = cells, 0, 0
            self._all = progress.add_task("cells", total=cells, count=f"0/{cells}")
            self._one = progress.add_task("", total=None, count="")

        def preparing(self, cell: Cell) -> None:
            made = cell.sequence.synth is not None
            text = f"{cell.sequence.name}: " + ("making the sequence" if made else "opening")
            progress.update(self._one, description=text, total=None, completed=0, count="")

        def running(self, cell: Cell, frames: int) -> None:
            self._frames, self._frame = frames, 0
            progress.update(self._one, description=cell.name, total=frames, completed=0, count=f"0/{frames}")

        def frame(self) -> None:
            self._frame += 1
            progress.update(self._one, completed=self._frame, count=f"{self._frame}/{self._frames}")
            progress.update(self._all, completed=self._done + self._frame / self._frames)
            if self._frame == self._frames:
                progress.update(self._one, description="measuring")

        def done(self, cell: Cell, result: CellResult, again: bool) -> None:
            if again:
                self._done += 1
                messages.print(f"{cell.name}: {_outcome(result)}", markup=False, highlight=False, soft_wrap=True)
            else:  # so that the time left is that of the others
                self._cells -= 1
            count = f"{self._done}/{self._cells}"
            progress.update(self._all, completed=self._done, total=self._cells, count=count)

    return Reporter()


def _outcome(result) -> str:
    if result.status == "failed":
        return f"failed: {result.reason}"
    abs_rel, density = (result.figures.get(name, float("nan")) for name in ("depth.abs_rel", "depth.density"))
    return f"AbsRel {abs_rel:.4f}, density {100 * density:.1f} %, {result.seconds:.0f} s"


def _print_summary(tables: list) -> None:
    """Medians of what was measured of depth, where the spec asks for it."""
    from polarmap.benchmark.formats import entry_text

    depth = next((table for table in tables if table.name == "figures_depth"), None)
    if depth is None:
        return
    places = [i for i, column in enumerate(depth.columns) if column.title in _SUMMARY]
    shown = Table(title=f"{depth.title}, medians over the seeds", title_justify="left")
    for heading in depth.label_headings:
        shown.add_column(heading, overflow="fold")
    for place in places:
        shown.add_column(depth.columns[place].title, justify="right", no_wrap=True)
    for row in depth.rows:
        shown.add_row(*row.labels, *(entry_text(row.entries[place], spread=False) for place in places))
    console.print(shown)
    for number, note in enumerate(depth.notes, start=1):
        console.print(f"({number}) {note}", markup=False, highlight=False, soft_wrap=True)
