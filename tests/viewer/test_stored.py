"""A run's folder, as the page shows it."""

from __future__ import annotations

import numpy as np
import pytest
from room_recording import FILE

from polarmap.errors import InputError
from polarmap.export.source import open_map
from polarmap.pipeline.config import Config
from polarmap.report.run_writer import RunWriter
from polarmap.viewer import stored
from polarmap.viewer.patch import SHOWN, patch_of


@pytest.fixture
def folder(room_run, tmp_path):
    keyframes, result = room_run
    with RunWriter(tmp_path / "run", Config(), FILE.camera) as writer:
        for keyframe in keyframes:
            writer.add_keyframe(keyframe)
        writer.add_map(result)
    return tmp_path / "run"


def test_stored_keyframes_are_those_of_the_run(folder, room_run, ranges):
    patches = list(stored.stored_patches(open_map(folder)))
    assert [patch.index for patch in patches] == [keyframe.index for keyframe in room_run[0]]
    for patch, keyframe in zip(patches, room_run[0], strict=True):
        there = patch_of(keyframe, ranges)
        np.testing.assert_allclose(patch.vertices, there.vertices, rtol=1e-6)
        np.testing.assert_array_equal(patch.colours["normal"], there.colours["normal"])
        np.testing.assert_allclose(patch.pose.rigid, keyframe.T_world_camera, atol=1e-12)
        assert set(patch.pictures) == set(SHOWN)


def test_of_many_keyframes_some_at_even_distances_are_shown(folder, room_run, monkeypatch):
    monkeypatch.setattr(stored, "MOST_KEYFRAMES", 3)
    indices = [patch.index for patch in stored.stored_patches(open_map(folder))]
    assert len(indices) == 3
    assert (indices[0], indices[-1]) == (room_run[0][0].index, room_run[0][-1].index)


def test_a_picture_of_another_size_is_refused(folder, room_run):
    first, *_ = (folder / "pictures").glob("*_image.jpg")
    index = room_run[0][0].index
    small = next((folder / "pictures").glob("map_*.jpg"), None) or first
    assert small != first
    (folder / "pictures" / f"{index:06d}_image.jpg").write_bytes(small.read_bytes())
    with pytest.raises(InputError, match=r"pixels|keyframe's size"):
        list(stored.stored_patches(open_map(folder)))
