"""Runs the cells of a benchmark that are not done yet, one after the other, and keeps what each gave."""

from __future__ import annotations

import logging
import os
import traceback
from dataclasses import dataclass, field
from datetime import datetime, timezone
from pathlib import Path
from time import monotonic
from typing import Any

from polarmap.benchmark.cells import RESULT_NAME, Cell, CellKey, CellResult, cells_of, read_result, select, write_result
from polarmap.benchmark.configuration import configuration, import_path
from polarmap.benchmark.measure import machine, measure
from polarmap.benchmark.sequences import MakeSequence, open_cell_sequence
from polarmap.benchmark.spec import MappingMethod, Spec
from polarmap.errors import InputError, PolarmapError
from polarmap.io.files import printable, read_text, reason, write_bytes
from polarmap.io.folder_lock import LOCK_NAME, FolderLock
from polarmap.io.recording.sequence import Sequence

log = logging.getLogger(__name__)

SPEC_NAME = "spec.yaml"
TRACEBACK_NAME = "traceback.txt"


class Watcher:
    """Is told how a benchmark goes on; does nothing by itself."""

    def started(self, cells: int) -> None:
        """So many cells are to be run or looked up."""

    def preparing(self, cell: Cell) -> None:
        """The cell's sequence is opened, or made."""

    def running(self, cell: Cell, frames: int) -> None:
        """The cell is run; its sequence has so many frames."""

    def frame(self) -> None:
        """One more frame of the cell is done."""

    def done(self, cell: Cell, result: CellResult, again: bool) -> None:
        """The cell is done, or with `again` False was before."""


@dataclass
class Benchmark:
    """A benchmark in its folder.

    spec_path: the file that `spec` is from; what is made starts from its folder. out: the folder for cells, made
    sequences and tables. make: see `MakeSequence`.
    """

    spec: Spec
    spec_path: Path
    out: Path
    make: MakeSequence
    watcher: Watcher = field(default_factory=Watcher)
    _sequences: dict[tuple[str, int], Sequence | PolarmapError] = field(default_factory=dict)

    def run(self, only: list[str], force: bool = False) -> dict[CellKey, CellResult]:
        """Run the cells that are not done with the same configuration, or with `force` all; their results.

        only: SEQUENCE/METHOD patterns; the others are left as they are. A cell that fails is a result too, and does
        not stop the rest. Raises InputError, before anything is run, where the folder is not a benchmark's, a pattern
        names nothing, a sequence or network is missing, or a setting is wrong.
        """
        cells = select(cells_of(self.spec), only)
        self._check(cells)
        with prepare_folder(self.out, self.spec_path):
            self.watcher.started(len(cells))
            return {cell.key: self._result(cell, force) for cell in cells}

    def results(self) -> dict[CellKey, CellResult | None]:
        """What is known of every cell now; None where it was not run with the present configuration."""
        return {cell.key: self._known(cell) for cell in cells_of(self.spec)}

    def _check(self, cells: list[Cell]) -> None:
        """Refuse what can be known to be wrong now; results of other programs may be missing."""
        for cell in cells:
            if isinstance(cell.method, MappingMethod) or os.path.exists(import_path(cell)):
                try:
                    configuration(cell)
                except InputError as error:
                    raise InputError(f"{self.spec_path}: {error}") from None

    def _configuration(self, cell: Cell) -> dict[str, Any]:
        """That of a cell, with the keyframes of the method at which it is compared."""
        state = configuration(cell)
        name = getattr(cell.method, "keyframes_of", None)
        if name is None:
            return state
        found = [
            result
            for other in cells_of(self.spec)
            if (other.sequence.name, other.method.name) == (cell.sequence.name, name)
            and other.seed in (cell.seed, self.spec.seeds[0])
            and (result := read_result(other.folder(self.out))) is not None
            and result.status == "complete"
        ]
        if not found:
            raise InputError(f"{cell.name}: {name} has no keyframes of this sequence; it must be run first")
        own = next((result for result in found if result.seed == cell.seed), found[0])
        return {**state, "keyframes": own.keyframes}

    def _known(self, cell: Cell) -> CellResult | None:
        result = read_result(cell.folder(self.out))
        if result is None:
            return None
        try:
            same = result.configuration == self._configuration(cell)
        except InputError:
            same = result.status == "failed"
        return result if same else None

    def _result(self, cell: Cell, force: bool) -> CellResult:
        known = None if force else self._known(cell)
        again = known is None or known.status != "complete"
        result = self._run(cell) if again else known
        self.watcher.done(cell, result, again)
        return result

    def _run(self, cell: Cell) -> CellResult:
        folder = cell.folder(self.out)
        start = monotonic()
        about = {
            "sequence": cell.sequence.name,
            "method": cell.method.name,
            "seed": cell.seed,
            "configuration": {},
            "started": datetime.now(timezone.utc).isoformat(timespec="seconds"),
            **machine(),
        }
        try:
            _clear(folder)
            about["configuration"] = self._configuration(cell)
            self.watcher.preparing(cell)
            sequence = self._sequence(cell)
            self.watcher.running(cell, len(sequence))
            indices = about["configuration"].get("keyframes")
            measured = measure(cell, sequence, folder, self.spec.keep == "run", self.watcher.frame, indices)
            outcome: dict[str, Any] = {"status": "complete", **vars(measured)}
        except PolarmapError as error:
            outcome = _failure(str(error))
        except Exception as error:  # a bug in one cell must not cost the others
            log.debug("%s failed", cell.name, exc_info=True)
            write_bytes(folder / TRACEBACK_NAME, printable(traceback.format_exc()).encode())
            outcome = _failure(printable(f"internal error, see {TRACEBACK_NAME}: {type(error).__name__}: {error}"))
        result = CellResult(**about, **outcome, seconds=round(monotonic() - start, 3))
        write_result(folder, result)
        return result

    def _sequence(self, cell: Cell) -> Sequence:
        """Opened once for all methods, and made once."""
        key = cell.sequence.name, cell.seed
        if key not in self._sequences:
            try:
                self._sequences[key] = open_cell_sequence(cell, self.out, self.spec_path.absolute().parent, self.make)
            except PolarmapError as error:
                self._sequences[key] = error
        if isinstance(self._sequences[key], PolarmapError):
            raise self._sequences[key]
        return self._sequences[key]


def prepare_folder(out: Path, spec_path: Path) -> FolderLock:
    """Make a benchmark's folder, with a copy of its spec; it is locked as long as what is returned is.

    Raises InputError where the folder holds other things, cannot be written, or another program is writing there.
    """
    try:
        if out.is_dir() and any(p.name != LOCK_NAME for p in out.iterdir()) and not (out / SPEC_NAME).exists():
            raise InputError(f"{out}: is not empty and not a benchmark's; choose another folder")
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{out}: cannot be used for output ({reason(error)}); choose another folder") from None
    lock = FolderLock(out)
    with lock.on_error():
        write_bytes(out / SPEC_NAME, read_text(spec_path).encode())
    return lock


def _clear(folder: Path) -> None:
    """Make a cell's folder, without the result of an earlier time: whatever happens now, that is over."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name in (RESULT_NAME, TRACEBACK_NAME):
            (folder / name).unlink(missing_ok=True)
    except OSError as error:
        raise PolarmapError(f"{folder}: cannot be written ({reason(error)})") from None


def _failure(why: str) -> dict[str, Any]:
    return {"status": "failed", "reason": " ".join(why.split())}
