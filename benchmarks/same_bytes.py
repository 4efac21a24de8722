"""Whether runs give the same bytes: with an empty and a filled compile cache, on one thread and on two.

    python benchmarks/same_bytes.py [--once] [--against FILE] [--write FILE]

Renders a small room, maps it in processes of their own with given poses and with odometry, by both ways of
densification, and compares digests of depth, normals, trajectory and mesh. Compiles anew: ten minutes.
--write keeps the digests of the runs, --against compares with such a file, as before and after a change that must not
change results; with --once each run is made once, with the compile cache that the machine has: two minutes.
Digests depend on the processor and on the versions of NumPy, Numba and OpenCV.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from polarmap.synth.scene_recording import record_scene

CASES = {
    "given": ["--poses", "groundtruth.txt"],
    "odometry": [],
    "given, paper": ["--poses", "groundtruth.txt", "--set", "densify.method=paper", "--prior", "sparse"],
    "odometry, paper": ["--set", "densify.method=paper", "--prior", "sparse"],
}


def main() -> None:
    arguments = _arguments()
    with tempfile.TemporaryDirectory() as folder:
        work = Path(folder)
        record_scene(work / "room", "room", 24)
        cache = None if arguments.once else work
        first = {name: _run(work, name, "first", cache) for name in CASES}
        differ = [] if arguments.once else _repeated(work, first)
    if arguments.against:
        differ += _differences(str(arguments.against), json.loads(arguments.against.read_text()), first)
    if arguments.write:
        arguments.write.write_text(json.dumps(first, indent=1) + "\n")
    print("\n".join(differ) or "no byte differs")
    sys.exit(bool(differ))


def _repeated(work: Path, first: dict) -> list[str]:
    """How runs with a filled cache and on one thread differ from the first ones."""
    warm = {name: _run(work, name, "warm", work) for name in CASES}
    single = {name: _run(work, name, "one thread", work, NUMBA_NUM_THREADS="1") for name in CASES}
    return [*_differences("warm", first, warm), *_differences("one thread", first, single)]


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--against", type=Path, help="digests of an earlier call")
    parser.add_argument("--once", action="store_true", help="do not compile anew, nor repeat")
    parser.add_argument("--write", type=Path, help="file for the digests")
    return parser.parse_args()


def _run(work: Path, name: str, kind: str, cache_folder: Path | None, **environment: str) -> dict[str, str]:
    """Digests of a run's files, by name. cache_folder: of compile caches, one for each case; None for the usual one."""
    out = work / f"{name} {kind}"
    options = [str(work / "room" / o) if o.endswith(".txt") else o for o in CASES[name]]
    command = [sys.executable, "-m", "polarmap", "run", str(work / "room"), "--out", str(out), *options]
    cache = {"NUMBA_CACHE_DIR": str(cache_folder / f"cache {name}")} if cache_folder else {}
    print(f"{name}, {kind} ...", flush=True)
    subprocess.run(command, env=os.environ | cache | environment, check=True, stdout=subprocess.DEVNULL)
    return digests(out)


def digests(out: Path) -> dict[str, str]:
    """SHA-256 of a run's meshes, clouds and trajectories, and of each keyframe's arrays together."""
    files = [*out.glob("*.ply"), *out.glob("trajectory*.txt"), *out.glob("keyframes*.txt")]
    found = {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in sorted(files)}
    for path in sorted((out / "keyframes").glob("*.npz")):
        digest = hashlib.sha256()
        with np.load(path, allow_pickle=False) as arrays:
            for name in sorted(arrays.files):
                digest.update(name.encode() + arrays[name].tobytes())
        found[f"keyframes/{path.name}"] = digest.hexdigest()
    return found


def _differences(kind: str, expected: dict, found: dict) -> list[str]:
    return [
        f"{name}: {file} is not the same ({kind})"
        for name in sorted(expected.keys() & found.keys())
        for file in sorted(expected[name].keys() | found[name].keys())
        if expected[name].get(file) != found[name].get(file)
    ]


if __name__ == "__main__":
    main()
