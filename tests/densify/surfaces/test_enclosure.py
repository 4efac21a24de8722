"""Planes that nothing is behind, in a room of a floor and a wall whose edge alone has points."""

from __future__ import annotations

import numpy as np
import pytest

from polarmap.densify.surfaces.enclosure import behind_enclosure
from polarmap.densify.surfaces.planes import Candidates

HEIGHT, WIDTH, CELL = 96, 128, 4
ROW = np.arange(HEIGHT)[:, None] * np.ones((1, WIDTH))
WALL = np.full((HEIGHT, WIDTH), 0.25, np.float32)  # inverse depth: four metres away
FLOOR = (0.25 + (ROW - 40.0) * 0.01).astype(np.float32)  # meets the wall in row 40, nearer below
FREE = np.full((HEIGHT, WIDTH), 5.0, np.float32)  # depth
FRAME = (ROW >= 40) & (ROW < 92)
FRAME[46:86, 6:-6] = False  # the floor has points all round its bare middle
NOWHERE = np.zeros((HEIGHT, WIDTH), bool)


def behind(extra: np.ndarray = NOWHERE, mirrored: np.ndarray = NOWHERE, floor: np.ndarray = FRAME) -> np.ndarray:
    """With points on the wall's upper part, on the floor where `floor`, and where `extra` far behind the floor."""
    depth = np.full((HEIGHT, WIDTH), np.nan, np.float32)
    depth[:30] = WALL[:30]
    depth[floor] = FLOOR[floor]
    depth[extra] = 0.3 * FLOOR[extra]
    return share_behind(depth, np.isfinite(depth).astype(np.float32), mirrored)


def share_behind(depth, reliability, mirrored, planes: bool = True) -> np.ndarray:
    """Of the wall, the floor and the free surface, or of the last alone."""
    centre = 0.5 * (depth.shape[0] - 1)
    found = np.array([[0.25, 0.0, 0.0], [0.25 + (centre - 40.0) * 0.01, 0.0, 0.01]]) if planes else np.empty((0, 3))
    surfaces = Candidates.of(found, [FREE[: depth.shape[0], : depth.shape[1]]], depth.shape)
    return behind_enclosure(surfaces.middles(CELL), found, depth, reliability, mirrored, CELL)


MIDDLE = np.s_[13:21, 3:-3]  # cells of the bare floor, well below the edge


def test_a_wall_is_not_seen_through_the_floor():
    share = behind()
    assert share.shape == (24, 32, 3) and share.dtype == np.float32
    assert (share[MIDDLE][..., [0, 2]] == 1.0).all() and (share[..., 1] <= 0.0)[10:].all()
    assert (share[:7, :, 0] == 0.0).all()  # above the edge the wall is nearest


def test_a_plane_that_points_are_behind_encloses_nothing():
    seen_through = NOWHERE.copy()
    seen_through[60:75, 50:75] = True
    assert (behind(extra=seen_through)[MIDDLE][..., 0] == 0.0).all()
    assert (behind(extra=seen_through, mirrored=seen_through)[MIDDLE][..., 0] == 1.0).all()


@pytest.mark.parametrize("columns", [np.s_[:60], np.s_[70:]])
def test_only_what_lies_between_its_points_is_enclosed(columns):
    """Points on one side of the image say nothing of the other."""
    part = NOWHERE.copy()
    part[:, columns] = FRAME[:, columns]
    enclosed = behind(floor=part)[18, :, 0] == 1.0
    inside = np.zeros(WIDTH, bool)
    inside[columns] = True
    assert enclosed[inside[::CELL] & inside[3::CELL]].mean() > 0.8
    assert not enclosed[~inside[::CELL] & ~inside[3::CELL]].any()


def test_without_planes_or_points_nothing_is_enclosed():
    depth = np.full((HEIGHT, WIDTH), np.nan, np.float32)
    nothing = np.zeros_like(depth)
    assert not share_behind(depth, nothing, NOWHERE).any()
    assert not share_behind(FLOOR, nothing + 1.0, NOWHERE, planes=False).any()


def test_images_need_not_be_multiples_of_cells():
    depth = np.where(FRAME | (ROW < 30), np.where(ROW < 30, WALL, FLOOR), np.nan).astype(np.float32)[:-2, :-3]
    share = share_behind(depth, np.isfinite(depth).astype(np.float32), NOWHERE[:-2, :-3])
    assert share.shape == (24, 32, 3) and (share[MIDDLE][..., 0] == 1.0).all()
