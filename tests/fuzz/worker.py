"""Reads changed files one after the other and says what went wrong; a process of its own, which may be killed.

    python -m fuzz.worker FOLDER SEED SUBJECT FIRST COUNT [SUBJECT FIRST COUNT ...]

Every input depends on its subject, the seed and its number alone. Lines on stdout, in JSON: [SUBJECT, NUMBER] before an
input is read, [SUBJECT, NUMBER, PROBLEM] for one that ends wrongly, and [] at the end.
"""

from __future__ import annotations

import dataclasses
import faulthandler
import json
import logging
import math
import os
import resource
import shutil
import socket
import sys
import time
import warnings
from pathlib import Path
from random import Random

import numpy as np
from pydantic import BaseModel

from polarmap.errors import PolarmapError

from .subjects import SUBJECTS, Subject

MOST_SECONDS = 10.0
MOST_WAITING = 60.0
MOST_BYTES = 1 << 30
LONGEST_MESSAGE = 500

_SPARE_BYTES = 3 << 30  # of address space, above what the process has at its start
_SPECIAL = 0.01  # share of inputs whose file is replaced by something that is no file


def change(subject: Subject, folder: Path, rng: Random) -> str:
    """Change one of the subject's files in a folder; returns what was done."""
    path = folder / rng.choice(subject.files)
    if rng.random() < _SPECIAL:
        return _replace(path, rng)
    data, names = path.read_bytes(), []
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        mutation = rng.choice(subject.changes)
        names.append(mutation.__name__)
        data = mutation(data, rng)
    path.write_bytes(data)
    return f"{path.name}: {', '.join(names)}"


def check(subject: Subject, folder: Path) -> str | None:
    """Read the folder; returns what is wrong with how that ends, None if nothing is."""
    started = time.process_time()  # whatever else the machine does
    try:
        value = subject.read(folder)
    except PolarmapError as error:
        value, message = None, str(error)
        if len(message) > LONGEST_MESSAGE or not message.isprintable() or not message.strip():
            return f"a message of {len(message)} characters: {message[:200]!r}"
    except BaseException as error:  # what fuzzing looks for
        return f"{type(error).__name__}: {str(error)[:300]}"
    seconds = time.process_time() - started
    peak = _peak()
    if seconds > MOST_SECONDS:
        return f"{seconds:.1f} s"
    if peak > MOST_BYTES:
        return f"{peak >> 20} MB"
    if subject.finite and _infinite(value):
        return "a value that is infinite"
    return None


def _replace(path: Path, rng: Random) -> str:
    """Put something in a file's place that is none, or is empty, or enormous."""
    path.unlink()
    kind = rng.choice(("nothing", "empty", "pipe", "socket", "folder", "device", "loop", "enormous"))
    if kind == "empty":
        path.write_bytes(b"")
    elif kind == "pipe":
        os.mkfifo(path)
    elif kind == "socket":
        with socket.socket(socket.AF_UNIX) as listening:
            before = os.getcwd()
            os.chdir(path.parent)
            listening.bind(path.name)
            os.chdir(before)
    elif kind == "folder":
        path.mkdir()
    elif kind in ("device", "loop"):
        path.symlink_to("/dev/zero" if kind == "device" else path)
    elif kind == "enormous":
        with open(path, "wb") as file:
            file.truncate(1 << 40)
    return f"{path.name}: {kind}"


def _infinite(value: object) -> bool:
    """Whether a number in a value, however deep, is infinite."""
    if isinstance(value, np.ndarray):
        return value.dtype.kind == "f" and bool(np.isinf(value).any())
    if isinstance(value, float):
        return math.isinf(value)
    if isinstance(value, BaseModel):
        return any(_infinite(part) for _, part in value)
    if isinstance(value, dict):
        return any(map(_infinite, value.values()))
    if isinstance(value, list | tuple):
        return any(map(_infinite, value))
    if dataclasses.is_dataclass(value):
        return any(_infinite(getattr(value, field.name)) for field in dataclasses.fields(value))
    return False


def _restore(original: Path, folder: Path) -> None:
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(original, folder)


def try_subject(scratch: Path, seed: int, name: str, first: int, count: int) -> None:
    """Try inputs number `first` to `first + count - 1` of a subject.

    Ends the process after one that took much memory.
    """
    subject, original, folder = SUBJECTS[name], scratch / "original", scratch / "changed"
    shutil.rmtree(original, ignore_errors=True)
    original.mkdir(parents=True)
    subject.make(original)
    _restore(original, folder)
    if (problem := check(subject, folder)) is not None:
        raise SystemExit(f"{name}: the unchanged files: {problem}")
    _limit_memory()
    for number in range(first, first + count):
        rng = Random(f"{name} {seed} {number}")
        _restore(original, folder)
        what = change(subject, folder, rng)
        print(json.dumps([name, number]), flush=True)
        faulthandler.dump_traceback_later(MOST_WAITING, exit=True)  # also where it hangs in C
        problem = check(subject, folder)
        faulthandler.cancel_dump_traceback_later()
        if problem is not None:
            print(json.dumps([name, number, f"{what}: {problem}"]), flush=True)
        if _peak() > MOST_BYTES:
            raise SystemExit("the largest memory of a process is known but once")


def _limit_memory() -> None:
    """From here on what asks for some gigabytes at once gets a MemoryError."""
    with open("/proc/self/statm") as file:
        used = int(file.read().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + _SPARE_BYTES, resource.RLIM_INFINITY))


def _peak() -> int:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


def main(scratch: Path, seed: int, plan: list[str]) -> None:
    """plan: subject, number of the first input, and count of inputs, in turns."""
    for name, first, count in zip(plan[::3], plan[1::3], plan[2::3], strict=True):
        try_subject(scratch, seed, name, int(first), int(count))
    print("[]", flush=True)


if __name__ == "__main__":
    warnings.simplefilter("ignore")
    logging.disable()
    main(Path(sys.argv[1]), int(sys.argv[2]), sys.argv[3:])
