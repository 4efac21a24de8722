"""`polarmap synth` in a process of its own says what went wrong there."""

from __future__ import annotations

import pytest

from polarmap.cli.synth_process import last_message, run_synth
from polarmap.errors import PolarmapError


def test_synth_fails_with_its_own_message(tmp_path):
    with pytest.raises(PolarmapError, match=r"polarmap synth scene nowhere .*: .*'nowhere' is not one of .*corridor"):
        run_synth(["scene", "nowhere", str(tmp_path / "x")], tmp_path)
    with pytest.raises(PolarmapError, match=r"No such option: --nothing"):
        run_synth(["scene", "table", str(tmp_path / "x"), "--nothing"], tmp_path)
    assert last_message("") == "ended without a message"
