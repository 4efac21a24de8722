"""Compiled code: the same results with an empty and a filled cache, and a start where no cache can be written."""

import threading
from pathlib import Path

import numpy as np
import pytest
from command_line import Ended, run_python
from numba.core.caching import IndexDataCacheFile

from polarmap import jit

_KERNEL = """
import hashlib
import numpy as np
from numba import prange
from polarmap.jit import FAST_MATH, njit

@njit(fastmath=FAST_MATH)
def correlation(a, b, u, v):
    total = mean = square = cross = np.float32(0)
    for i in range(25):
        x, y = a[v, u + i], b[v, u + i]
        weight = np.float32(1) / (np.float32(1) + (x - y) * (x - y))
        total += weight
        mean += weight * x
        square += weight * x * x
        cross += weight * x * y
    mean /= total
    return (cross / total - mean * mean) / np.sqrt(square / total - mean * mean + np.float32(1e-3))

@njit(parallel=True, fastmath=FAST_MATH)
def correlations(a, b, out):
    for v in prange(a.shape[0]):
        for u in range(a.shape[1] - 25):
            out[v, u] = correlation(a, b, u, v)

a, b = np.random.default_rng(0).random((2, 64, 128), np.float32)
out = np.zeros_like(a)
correlations(a, b, out)
print(hashlib.sha256(out.tobytes()).hexdigest())
"""

_STEREO = """
import hashlib
import numpy as np
from polarmap.data.polarization_image import PolarizationImage
from polarmap.data.view import View
from polarmap.geometry.camera import PinholeCamera
from polarmap.stereo.options import PatchMatchOptions
from polarmap.stereo.patchmatch.method import patchmatch

image = np.random.default_rng(0).random((40, 70), np.float32)
moved = np.eye(4)
moved[0, 3] = 0.1
images = [PolarizationImage.unpolarized(image[:, 3 * i : 64 + 3 * i].copy()) for i in range(2)]
views = [View(image, np.linalg.matrix_power(moved, i)) for i, image in enumerate(images)]
camera = PinholeCamera(64, 40, 60.0, 60.0, 32.0, 20.0)
planes = patchmatch(views[0], views[1:], camera, (1.0, 10.0), PatchMatchOptions(sweeps=(2, 1), trials=(3, 2)))
arrays = (planes.inverse_depth, planes.gradient_u, planes.gradient_v, planes.score, planes.sigma)
print(hashlib.sha256(b"".join(a.tobytes() for a in arrays)).hexdigest())
"""


def _run(script: Path, **environment: str) -> Ended:
    ended = run_python(script, **environment)
    assert ended.status == 0, ended.err
    return ended


@pytest.fixture
def kernel(tmp_path):
    script = tmp_path / "kernel.py"
    script.write_text(_KERNEL)
    return script


@pytest.mark.slow
def test_results_are_the_same_bytes_with_an_empty_a_filled_and_a_damaged_cache(kernel, tmp_path):
    cache = tmp_path / "cache"
    cold = _run(kernel, NUMBA_CACHE_DIR=str(cache)).out
    kept = {path: path.stat().st_mtime_ns for path in cache.rglob("*.nbc")}
    assert len(cold) > 60
    assert kept
    assert _run(kernel, NUMBA_CACHE_DIR=str(cache), NUMBA_NUM_THREADS="1").out == cold
    assert kept == {path: path.stat().st_mtime_ns for path in cache.rglob("*.nbc")}
    for path in kept:
        path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    assert _run(kernel, NUMBA_CACHE_DIR=str(cache)).out == cold


def test_a_cache_of_an_earlier_version_whose_types_have_other_names_does_no_harm(tmp_path):
    """As after an upgrade in place: the index of the old code names a class that is gone."""
    text = (
        "from typing import NamedTuple\nfrom polarmap.jit import njit\n"
        "class {name}(NamedTuple):\n    side: float\n"
        "@njit\ndef area(square):\n    return square.side * square.side\n"
        "print(area({name}(3.0)))\n"
    )
    (tmp_path / "run.py").write_text("import squares\n")
    for name in ("Square", "Quadrangle"):
        (tmp_path / "squares.py").write_text(text.format(name=name))
        for _ in range(2):
            ended = _run(tmp_path / "run.py", NUMBA_CACHE_DIR=str(tmp_path / "cache"))
            assert (ended.out.strip(), ended.err) == ("9.0", "")


@pytest.mark.slow
def test_stereo_is_the_same_bytes_with_an_empty_and_a_filled_cache(tmp_path):
    script = tmp_path / "stereo.py"
    script.write_text(_STEREO)
    cold = _run(script, NUMBA_CACHE_DIR=str(tmp_path / "cache")).out
    assert len(cold) > 60
    assert _run(script, NUMBA_CACHE_DIR=str(tmp_path / "cache"), NUMBA_NUM_THREADS="1").out == cold


def test_without_a_folder_for_the_cache_kernels_are_compiled_and_that_is_said_once(kernel, tmp_path):
    (tmp_path / "file").touch()
    done = _run(
        kernel,
        NUMBA_CACHE_DIR=str(tmp_path / "file" / "cache"),
        NUMBA_CACHE_LOCATOR_CLASSES="UserProvidedCacheLocator",  # the others fall back to folders that exist here
    )
    assert len(done.out) > 60
    assert done.err.count("compiled code cannot be kept") == 1
    assert "NUMBA_CACHE_DIR" in done.err


def test_a_full_disk_under_the_cache_is_named_and_the_result_is_given(monkeypatch, caplog):
    def full(self, key, data):
        raise OSError(28, "No space left on device", "/cache/kernel.nbc")

    monkeypatch.setattr(IndexDataCacheFile, "save", full)
    jit._say_once.cache_clear()

    @jit.njit
    def twice(x):
        return 2 * x

    assert twice(3) == 6
    assert twice(1.5) == 3.0
    assert [r.getMessage().count("/cache/kernel.nbc: No space left on device") for r in caplog.records] == [1]


def test_two_processes_that_compile_at_once_do_not_take_each_others_code():
    """Both have read an index that knows neither signature; the first one's code is written last."""

    def twice(x):
        return 2 * x

    first, second = (jit.KernelCache(twice)._cache_file for _ in range(2))
    first.flush()
    names = [files._data_name(1) for files in (first, second)]
    for files, name, key in ((first, names[0], "int"), (second, names[1], "float")):
        files._save_index({key: name})
    second._save_data(names[1], "code for float")
    first._save_data(names[0], "code for int")
    assert first.load("float") == "code for float"
    assert first.load("int") is None
    first.flush()


def test_fast_math_sums_in_any_order():
    @jit.njit(fastmath=jit.FAST_MATH)
    def total(values):
        result = np.float32(0)
        for value in values:
            result += value
        return result

    values = np.random.default_rng(0).random(1000, np.float32)
    np.testing.assert_allclose(total(values), values.sum(), rtol=1e-5)


def test_two_threads_may_be_in_kernels_at_once():
    """Each waits for the other's mark: the first one's would never come if kernels held Python's global lock."""

    @jit.njit
    def meet(marks, own, other, longest):
        for turn in range(1, longest):
            marks[own] = turn
            if marks[other] > 0:
                return True
        return False

    assert meet(np.ones(2, np.int64), 0, 1, 2)  # compiles
    marks, met = np.zeros(2, np.int64), []
    arguments = ((marks, 0, 1, 10**10), (marks, 1, 0, 10**10))  # some seconds at most
    threads = [threading.Thread(target=lambda given=given: met.append(meet(*given))) for given in arguments]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert met == [True, True]


def test_code_that_was_compiled_in_another_way_is_not_taken(monkeypatch, tmp_path):
    monkeypatch.setattr("numba.config.CACHE_DIR", str(tmp_path))

    def twice(x):
        return 2 * x

    first = jit.KernelCache(twice)._cache_file
    first.flush()
    first.save("int", "code")
    assert jit.KernelCache(twice)._cache_file.load("int") == "code"
    monkeypatch.setattr(jit, "_OWN_STAMP", "another way")
    assert jit.KernelCache(twice)._cache_file.load("int") is None
