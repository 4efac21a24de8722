"""Compare mypy's errors with those that are known, by file and kind: none may come to them.

    python .ci/check_types.py                 # exit status 1 where there are more than .ci/mypy_baseline.json has
    python .ci/check_types.py --write         # write what there is into the baseline, if that has no more of any
    python .ci/check_types.py --write --more  # even if: a module was moved, or another mypy sees more

Modules that are not mypy's business (numpy, for one) are named in pyproject.toml.
"""

from __future__ import annotations

import argparse
import json
import re
import subprocess
import sys
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
BASELINE = ROOT / ".ci" / "mypy_baseline.json"
ERROR = re.compile(r"(?P<file>[^:\n]+):\d+: error: .*?(?:\[(?P<code>[a-z-]+)\])?", re.DOTALL)

Counts = dict[str, dict[str, int]]
"""How many errors of which code each file has."""


def main() -> int:
    parser = argparse.ArgumentParser(description="Compare mypy's errors with the baseline.")
    parser.add_argument("--write", action="store_true", help="write the baseline")
    parser.add_argument("--more", action="store_true", help="even if it grows")
    options = parser.parse_args()
    errors = mypy_errors()
    found, known = counts(errors), read_baseline()
    more, fewer = differences(found, known), differences(known, found)
    if more and not options.more:
        report_new(errors, more, found, known)
        return 1
    if options.write:
        BASELINE.write_text(json.dumps(found, indent=1, sort_keys=True) + "\n")
        print(f"types: {total(found)} errors in {len(found)} files are the baseline now")
    elif fewer:
        print(f"types: {total(known) - total(found)} errors fewer than known; run .ci/check_types.py --write")
    else:
        print(f"types: no new errors ({total(found)} known ones in {len(found)} files)")
    return 0


def mypy_errors() -> list[re.Match[str]]:
    """One match of ERROR for each error. Ends the program where mypy itself fails."""
    command = [sys.executable, "-m", "mypy", "--no-pretty", "--no-error-summary", "--no-color-output"]
    ended = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    matches = [match for line in ended.stdout.splitlines() if (match := ERROR.fullmatch(line))]
    if ended.returncode not in (0, 1) or (ended.returncode == 1 and not matches):
        sys.exit(f"types: mypy failed\n{ended.stdout}{ended.stderr}")
    return matches


def counts(errors: list[re.Match[str]]) -> Counts:
    found: dict[str, Counter[str]] = {}
    for error in errors:
        found.setdefault(error["file"], Counter())[error["code"] or "other"] += 1
    return {file: dict(codes) for file, codes in found.items()}


def read_baseline() -> Counts:
    return json.loads(BASELINE.read_text()) if BASELINE.exists() else {}


def differences(one: Counts, other: Counts) -> list[tuple[str, str]]:
    """(file, code) of which `one` has more errors than `other`."""
    return sorted(
        (file, code)
        for file, codes in one.items()
        for code, number in codes.items()
        if number > other.get(file, {}).get(code, 0)
    )


def report_new(errors: list[re.Match[str]], more: list[tuple[str, str]], found: Counts, known: Counts) -> None:
    """All errors of the files and codes that have more; which of them are new, mypy cannot know."""
    for file, code in more:
        before, now = known.get(file, {}).get(code, 0), found[file][code]
        print(f"types: {file}: {now} errors [{code}], {before} of them known:")
        for error in errors:
            if (error["file"], error["code"] or "other") == (file, code):
                print("  " + error[0])
    print("types: give these their types; where a module was only moved: .ci/check_types.py --write --more")


def total(found: Counts) -> int:
    return sum(sum(codes.values()) for codes in found.values())


if __name__ == "__main__":
    sys.exit(main())
