"""A run that is killed leaves every file whole or absent (many more: python benchmarks/kill_runs.py 50)."""

import pytest

from benchmarks.kill_runs import kill_runs, make_sequence


@pytest.mark.slow
def test_what_killed_runs_leave_is_whole(tmp_path):
    read = kill_runs(make_sequence(tmp_path / "sequence"), tmp_path / "out", count=2, seed=3)
    assert len(read) == 2
    assert max(read) > 5
