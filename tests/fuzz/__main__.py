"""Tries changed inputs on all readers and reports every one that ends wrongly; exit status 1 if there is any.

python -m fuzz [--count 100000] [--seed 0] [--only NAME] [--keep FOLDER]
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
import tempfile
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from .subjects import SUBJECTS

Plan = list[tuple[str, int, int]]
"""Subject, number of its first input, and how many."""


@dataclass(frozen=True)
class Finding:
    """An input that ends wrongly; `python -m fuzz.worker FOLDER SEED SUBJECT NUMBER 1` makes it again."""

    subject: str
    seed: int
    number: int
    problem: str


def fuzz(count: int, seed: int, only: str | None = None, keep: Path | None = None) -> list[Finding]:
    """Try about `count` inputs, shared out among the readers; returns what ends wrongly.

    keep: a folder for the files of findings.
    """
    names = [name for name in SUBJECTS if only is None or name == only]
    if not names:
        raise SystemExit(f"no reader is called {only!r}; known are {', '.join(SUBJECTS)}")
    total = sum(SUBJECTS[name].share for name in names)
    plan = [(name, 0, max(round(count * SUBJECTS[name].share / total), 1)) for name in names]
    findings: list[Finding] = []
    with tempfile.TemporaryDirectory() as scratch:
        while plan:
            found, plan = _run(Path(scratch), seed, plan)
            for finding in found:
                print(f"{finding.subject}, seed {seed}, number {finding.number}: {finding.problem}", flush=True)
                if keep is not None:
                    _keep(keep, Path(scratch), finding)
            findings += found
    return findings


def _run(scratch: Path, seed: int, plan: Plan) -> tuple[list[Finding], Plan]:
    """Findings of a worker, and what it left undone because it ended."""
    process = _worker(scratch, seed, plan)
    *lines, last = [json.loads(line) for line in process.stdout.splitlines() if line.startswith("[")] or [None]
    if last is None:
        raise SystemExit(f"the readers cannot be tried: {process.stderr.strip()[-2000:]}")
    findings = [Finding(line[0], seed, *line[1:]) for line in (*lines, last) if len(line) == 3]
    if not last:
        return findings, []
    name, number = last[:2]
    if len(last) == 2:
        problem = f"the process ended ({process.returncode}): {process.stderr.strip()[-400:]}"
        findings.append(Finding(name, seed, number, problem))
    place = next(i for i, part in enumerate(plan) if part[0] == name)
    left = sum(plan[place][1:]) - number - 1
    return findings, [*([(name, number + 1, left)] if left else []), *plan[place + 1 :]]


def _worker(scratch: Path, seed: int, plan: Plan) -> subprocess.CompletedProcess:
    words = [str(word) for part in plan for word in part]
    command = [sys.executable, "-m", "fuzz.worker", str(scratch), str(seed), *words]
    return subprocess.run(command, cwd=Path(__file__).parents[1], capture_output=True, text=True)


def _keep(keep: Path, scratch: Path, finding: Finding) -> None:
    """Make a finding's files again, in a folder of its own."""
    _worker(scratch, finding.seed, [(finding.subject, finding.number, 1)])
    folder = keep / f"{finding.subject.replace(' ', '_')}_{finding.seed}_{finding.number}"
    with suppress(shutil.Error):  # of pipes and sockets, which are not copied
        shutil.copytree(scratch / "changed", folder, symlinks=True, dirs_exist_ok=True)


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m fuzz", description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=100_000, help="inputs in all")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", help="one reader alone")
    parser.add_argument("--keep", type=Path, help="a folder for the files of what ends wrongly")
    options = parser.parse_args()
    findings = fuzz(options.count, options.seed, options.only, options.keep)
    print(f"{options.count} inputs, {len(findings)} end wrongly")
    return 1 if findings else 0


if __name__ == "__main__":
    sys.exit(main())
