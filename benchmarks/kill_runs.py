"""Kill a run at random moments and read back what it left: every file must be whole or absent.

    python benchmarks/kill_runs.py 50

Each run maps a tiny sequence, again and again into the same folder, and is killed (SIGKILL) at a moment drawn between
its first file and its last. Then every file in the folder is read with the package's own readers.
"""

from __future__ import annotations

import argparse
import random
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from polarmap.errors import InputError
from polarmap.geometry.camera import PinholeCamera
from polarmap.io.files import PART_FILE, data_lines, read_text
from polarmap.io.folder_lock import LOCK_NAME
from polarmap.io.formats.depth_png import read_depth_png
from polarmap.io.formats.images import read_picture
from polarmap.io.formats.ply_reader import read_ply
from polarmap.io.formats.trajectory import read_trajectory
from polarmap.io.run_folder.folder import read_results
from polarmap.io.run_folder.keyframe_file import read_keyframe
from polarmap.pipeline.config import read_config
from polarmap.synth.scene_recording import record_scene

COMMAND = (sys.executable, "-c", "from polarmap.cli import main; main()", "run")
OPTIONS = ("--force", "--prior", "sparse", "--stages", "--set", "fusion.min_faces=0")
_LONGEST = 600.0  # seconds until a run writes


def make_sequence(folder: Path, frames: int = 5, width: int = 64, height: int = 48) -> Path:
    """A small room in small pictures; the camera moves far enough for every frame to be a keyframe."""
    camera = PinholeCamera(width, height, 0.75 * width, 0.75 * width, (width - 1) / 2, (height - 1) / 2)
    record_scene(folder, "room", frames, camera, step=0.08, supersample=1)
    return folder


def kill_runs(sequence: Path, out: Path, count: int, seed: int = 0) -> list[int]:
    """Kill `count` runs into `out`; how many files were read back after each. Raises InputError for one that is torn.

    Of two whole runs before, the first compiles and the second tells how long one takes; one after must find its way
    through what the killed ones left.
    """
    moments = random.Random(seed)
    _run(sequence, out, None)
    duration = _run(sequence, out, None)
    read = []
    for _ in range(count):
        _run(sequence, out, moments.uniform(0.0, duration))
        read.append(read_back(out))
    _run(sequence, out, None)
    left = [path for path in out.rglob("*") if PART_FILE.fullmatch(path.name) or path.name == LOCK_NAME]
    if left:
        raise InputError(f"{left[0]}: was not removed by the run that followed")
    read_back(out)
    return read


def read_back(out: Path) -> int:
    """Read every file of a run's folder; returns how many. Raises InputError where one is not whole, or unknown."""
    results = read_results(out) if (out / "results.json").exists() else None
    files = [path for path in sorted(out.rglob("*")) if path.is_file()]
    files = [path for path in files if not PART_FILE.fullmatch(path.name) and path.name != LOCK_NAME]
    for path in files:
        _read(path, 1.0 if results is None else results.depth_scale or 1.0)
    return len(files)


def _read(path: Path, depth_scale: float) -> None:
    if path.suffix == ".npz":
        read_keyframe(path)
    elif path.parent.name == "depth":
        read_depth_png(path, depth_scale)
    elif path.suffix in (".png", ".jpg"):
        read_picture(path)
    elif path.suffix == ".ply":
        read_ply(path)
    elif path.suffix == ".txt":
        _read_poses(path)
    elif path.name == "config.yaml":
        read_config(path)
    elif path.name == "report.html":
        if not read_text(path).rstrip().endswith("</html>"):
            raise InputError(f"{path}: has no end")
    elif path.name != "results.json":
        raise InputError(f"{path}: no file that a run writes")


def _read_poses(path: Path) -> None:
    if not read_text(path).endswith("\n"):
        raise InputError(f"{path}: the last line has no end")
    if data_lines(path):  # none yet at the start
        read_trajectory(path, "tum")


def _run(sequence: Path, out: Path, kill_after: float | None) -> float:
    """Map, or be killed so many seconds after the run has taken its folder; returns the seconds from there to its end.

    Raises InputError where a run that was not killed fails.
    """
    command = (*COMMAND, str(sequence), "--poses", str(sequence / "groundtruth.txt"), "--out", str(out), *OPTIONS)
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True) as process:
        try:
            start = _wait_for_lock(out, process)
            if kill_after is None:
                process.wait(_LONGEST)
            else:
                time.sleep(max(0.0, start + kill_after - time.monotonic()))
        finally:
            process.kill()
        problem = process.stderr.read()
    if kill_after is None and process.returncode != 0:
        raise InputError(f"{sequence}: the run fails: {problem}")
    return time.monotonic() - start


def _wait_for_lock(out: Path, process: subprocess.Popen) -> float:
    """When the process took the folder."""
    deadline = time.monotonic() + _LONGEST
    while process.poll() is None and time.monotonic() < deadline:
        try:
            if (out / LOCK_NAME).read_text().strip() == str(process.pid):
                break
        except OSError:
            pass
        time.sleep(0.002)
    return time.monotonic()


def main() -> None:
    """From the command line."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("count", type=int, help="runs to kill")
    parser.add_argument("--seed", type=int, default=0, help="of the moments")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        sequence = make_sequence(Path(folder) / "sequence")
        read = kill_runs(sequence, Path(folder) / "out", arguments.count, arguments.seed)
    print(f"{len(read)} runs killed, {sum(read)} files read back ({min(read)} to {max(read)} a run), all whole")


if __name__ == "__main__":
    main()
