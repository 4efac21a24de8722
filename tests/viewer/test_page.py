"""The page, with viser itself."""

from __future__ import annotations

import numpy as np
import pytest

from polarmap.geometry.sim3 import Sim3
from polarmap.viewer.patch import COLOURS, patch_of
from polarmap.viewer.watcher import Tracking

pytest.importorskip("viser", reason='viser is not installed; pip install "polarmap[view]"')


@pytest.fixture
def page():
    from polarmap.viewer.page import Page

    page = Page(port=18_080)
    yield page
    page.close()


@pytest.fixture
def patches(room_run, ranges):
    return [patch_of(keyframe, ranges) for keyframe in room_run[0]]


def test_keyframes_stand_where_they_are_and_move(page, patches):
    for patch in patches:
        page.add(patch)
    first, last = patches[0].pose.translation, patches[-1].pose.translation
    np.testing.assert_allclose(page._nodes[patches[-1].index].position, last - first, atol=1e-6)
    page.move(patches[-1].index, Sim3(2.0, np.eye(3), first + np.array([1.0, 2.0, 3.0])))
    node = page._nodes[patches[-1].index]
    np.testing.assert_allclose(node.position, [1, 2, 3], atol=1e-6)
    np.testing.assert_allclose(node.wxyz, [1, 0, 0, 0], atol=1e-6)
    assert node.scale == 2.0
    page.move(12345, Sim3.from_matrix(np.eye(4)))  # of a keyframe that is not shown


def test_the_panel_follows_the_newest_until_one_is_picked(page, patches):
    for patch in patches[:-1]:
        page.add(patch)
    assert page._name.content == f"frame {patches[-2].index}"
    page._picked.value = patches[0].index
    page.refresh()
    assert page._name.content == f"frame {patches[0].index}"
    page.add(patches[-1])
    assert page._name.content == f"frame {patches[0].index}"


def test_the_panel_follows_a_run_whose_first_keyframe_is_not_its_first_frame(page, patches):
    for patch in patches[1:]:
        page.add(patch)
        assert page._name.content == f"frame {patch.index}"


def test_the_way_is_drawn_in_pieces_that_hang_together(page, monkeypatch):
    import polarmap.viewer.page as module

    monkeypatch.setattr(module, "_PIECE", 4)
    monkeypatch.setattr(module, "_MOST_WAY", 20)
    for x in range(15):
        before = page._lines[:-1]
        page.track(Tracking(np.eye(4), 0, 0), [np.array([x, 0.0, 0.0])])
        assert page._lines[: len(before)] == before  # what is full is not sent again
    steps = np.concatenate([line.points for line in page._lines])
    np.testing.assert_allclose(steps[:, :, 0], np.stack([np.arange(14), np.arange(1, 15)], axis=1))
    page.track(Tracking(np.eye(4), 0, 0), [np.array([x, 0.0, 0.0]) for x in range(15, 21)])
    steps = np.concatenate([line.points for line in page._lines])
    np.testing.assert_allclose(steps[:, 0, 0], np.arange(0, 20, 2))
    page.track(Tracking(np.eye(4), 1, 0), [np.zeros(3)])
    assert not page._lines


def test_every_colour_can_be_chosen(page, patches):
    for patch in patches:
        page.add(patch)
    seen = {}
    for colour in COLOURS:
        page._kind.value = colour
        page.refresh()
        seen[colour] = np.array(page._colours(patches[-1]))
    assert len({colours.tobytes() for colours in seen.values()}) == len(COLOURS)


def test_the_fused_surface_takes_the_place_of_the_pieces(page, patches, room_run):
    for patch in patches:
        page.add(patch)
    page.show_map(room_run[1])
    assert page._mesh.visible and not any(node.visible for node in page._nodes.values())
    page._whole.value = False
    page.refresh()
    assert not page._mesh.visible and all(node.visible for node in page._nodes.values())


def test_another_segment_begins_with_an_empty_scene(page, patches):
    for patch in patches:
        page.add(patch)
    page.track(Tracking(np.eye(4), 1, 5, late=12.3, waiting=2, skipped=3, missed=4), [np.zeros(3)])
    assert not page._nodes and "pose after 12 ms, 2 keyframes wait" in page._state.content


def test_what_the_browser_holds_is_bounded(page, patches, monkeypatch):
    import polarmap.viewer.page as module

    monkeypatch.setattr(module, "_MOST_PATCHES", 4)
    for patch in patches:
        page.add(patch)
    assert len(page._nodes) == len(page._patches) <= 4
    assert patches[-1].index in page._nodes and patches[0].index in page._nodes
