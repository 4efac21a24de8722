"""Occupancy and distances in a room whose geometry is a formula."""

from __future__ import annotations

import logging

import cv2
import numpy as np
import pytest
import yaml
from command_line import refused
from export_room import FAR, HALF, HEIGHT, PILLAR_CENTRE, PILLAR_HALF, in_pillar, room_keyframes, to_surface, write_room
from scipy.ndimage import binary_erosion, distance_transform_edt

from polarmap.export.distances import UNOBSERVED, signed_distances
from polarmap.export.grid import make_grid
from polarmap.export.navigation import export_navigation
from polarmap.export.occupancy import FREE, OCCUPIED, UNKNOWN
from polarmap.export.source import open_map
from polarmap.export.upright import found_up, upright

VOXEL = 0.05
UP = np.array([0.0, 0.0, 1.0])


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    return write_room(tmp_path_factory.mktemp("room") / "run")


@pytest.fixture(scope="module")
def written(run, tmp_path_factory):
    out = tmp_path_factory.mktemp("nav") / "out"
    export_navigation(open_map(run), out, UP, voxel_size=VOXEL, height=(0.1, 0.9), truncation=0.8)
    return out


@pytest.fixture(scope="module")
def esdf(written):
    with np.load(written / "esdf.npz") as archive:
        return dict(archive)


def centres(esdf) -> np.ndarray:
    """Of all voxels, in the world."""
    index = np.indices(esdf["distances"].shape).reshape(3, -1).T
    local = esdf["origin"] + esdf["voxel_size"] * (index + 0.5)
    return local @ esdf["T_world_grid"][:3, :3].T + esdf["T_world_grid"][:3, 3]


def test_distances_are_those_of_the_room(esdf):
    points, found = centres(esdf), esdf["distances"].reshape(-1)
    free = (esdf["observed"] & ~esdf["occupied"]).reshape(-1)
    inside = (np.abs(points[:, :2]) < HALF).all(axis=1) & (points[:, 2] > 0) & (points[:, 2] < HEIGHT)
    checked = free & inside & ~in_pillar(points)
    true = np.minimum(to_surface(points[checked]), 0.8)
    assert np.count_nonzero(checked) > 100_000
    assert np.abs(found[checked] - true).max() < 1.5 * VOXEL
    assert abs(np.median(found[checked] - true)) < 0.5 * VOXEL


def test_the_room_is_free_its_walls_occupied_and_all_behind_unknown(esdf):
    points = centres(esdf)
    occupied, observed = esdf["occupied"].reshape(-1), esdf["observed"].reshape(-1)
    beyond = np.maximum(np.abs(points[:, :2]) - HALF, 0.0).max(axis=1)
    beyond = np.maximum(beyond, np.maximum(-points[:, 2], points[:, 2] - HEIGHT))
    well_inside = (beyond <= 0) & ~in_pillar(points) & (to_surface(points) > 1.5 * VOXEL)
    assert (observed & ~occupied)[well_inside].mean() > 0.99
    assert not occupied[well_inside].any()
    on_walls = (np.abs(np.abs(points[:, 0]) - HALF[0]) < 0.5 * VOXEL) & (np.abs(points[:, 1]) < 1.4)
    assert occupied[on_walls & (np.abs(points[:, 2] - 1.2) < 0.9)].mean() > 0.99
    assert not (observed & ~occupied)[beyond > VOXEL].any()
    assert observed[beyond > VOXEL].mean() < 0.02  # where a pixel's plane goes on beyond a corner
    deep = in_pillar(points) & (to_pillar_side(points) > 1.5 * VOXEL)
    assert deep.any() and not observed[deep].any()
    assert (esdf["distances"].reshape(-1)[~observed] == UNOBSERVED).all()


def to_pillar_side(points):
    return (PILLAR_HALF - np.abs(points - PILLAR_CENTRE)).min(axis=1)


def test_what_a_thing_hides_is_unknown(tmp_path):
    run = write_room(tmp_path / "run", most=2)
    source = open_map(run)
    export_navigation(source, tmp_path / "out", UP, voxel_size=VOXEL)
    with np.load(tmp_path / "out" / "esdf.npz") as archive:
        esdf = dict(archive)
    points, observed = centres(esdf), esdf["observed"].reshape(-1)
    hidden = np.ones(len(points), bool)
    for keyframe in source.keyframes(""):
        eye = keyframe.T_world_camera[:3, 3]
        between = [in_pillar(eye + share * (points - eye)) for share in np.linspace(0.2, 0.95, 40)]
        hidden &= np.any(between, axis=0)
    well = binary_erosion(hidden.reshape(esdf["observed"].shape), iterations=2).reshape(-1)
    away = well & (to_surface(points) > 2.5 * VOXEL) & ~in_pillar(points) & (points[:, 0] < 1.8)
    assert np.count_nonzero(away) > 100
    assert not observed[away].any()
    assert observed[~hidden & (np.abs(points[:, :2]) < 1.0).all(axis=1)].any()


def test_a_map_server_reads_the_plan(written):
    """As map_server does it: thresholds on 1 - shade, the last row at the origin."""
    settings = yaml.safe_load((written / "occupancy.yaml").read_text())
    shades = cv2.imread(str(written / settings["image"]), cv2.IMREAD_UNCHANGED)
    odds = (255 - shades.astype(float)) / 255
    if settings["negate"]:
        odds = 1 - odds

    def at(x, y):
        column, row = (int((p - o) / settings["resolution"]) for p, o in zip((x, y), settings["origin"], strict=False))
        value = odds[len(odds) - 1 - row, column]
        if value > settings["occupied_thresh"]:
            return "occupied"
        return "free" if value < settings["free_thresh"] else "unknown"

    assert settings["resolution"] == VOXEL and settings["mode"] == "trinary"
    assert at(-1.0, 0.0) == at(1.5, -1.0) == at(0.0, 1.2) == "free"
    assert at(2.0, 0.3) == at(-0.5, 1.5) == at(1.1, 0.3) == "occupied"
    assert at(-2.09, 0.0) == at(0.9, 0.3) == "unknown"
    assert {at(x, -1.5) for x in np.linspace(-1.9, 1.9, 50)} == {"occupied"}


def test_slices_are_pictures_with_y_up(written):
    pictures = sorted((written / "slices").iterdir())
    assert len(pictures) == 5
    picture = cv2.imread(str(pictures[0]))
    plan = cv2.imread(str(written / "occupancy.pgm"), cv2.IMREAD_UNCHANGED)
    factor = picture.shape[0] // plan.shape[0]
    black = (picture[::factor, ::factor] == 0).all(axis=-1)
    assert black.any() and (plan[black] == 0).all()


def test_up_and_floor_are_found(run):
    source = open_map(run)
    up = found_up(source)
    assert up.reason == "level surfaces near the cameras' mean"
    assert np.degrees(np.arccos(up.direction @ UP)) < 0.1
    mean = np.mean([-k.T_world_camera[:3, 1] for k in source.keyframes("")], axis=0)
    assert mean[2] > 0.9  # what it begins from
    grid = make_grid(source, up.direction, VOXEL, 0.1)
    assert abs(grid.floor) < 0.5 * VOXEL and abs(grid.eye - 1.25) < 0.06


def test_upright_frames_are_rotations_with_z_along_up():
    for up in [*np.random.default_rng(0).standard_normal((20, 3)).tolist(), [1.0, 0, 0], [0, 0, 1.0], [0, -1.0, 0]]:
        up = np.array(up) / np.linalg.norm(up)
        R = upright(up)[:3, :3]
        assert np.allclose(R @ [0, 0, 1], up) and np.allclose(R @ R.T, np.eye(3)) and np.linalg.det(R) > 0
    assert np.allclose(upright(UP), np.eye(4))


def test_a_far_world_has_the_same_grid_and_says_where_it_is(run, esdf, tmp_path):
    far = write_room(tmp_path / "far", shift=FAR)
    export_navigation(open_map(far), tmp_path / "out", UP, voxel_size=VOXEL, height=(0.1, 0.9), truncation=0.8)
    with np.load(tmp_path / "out" / "esdf.npz") as archive:
        assert np.mean(archive["distances"] == esdf["distances"]) > 0.999  # poses are rounded to a nanometre there
        assert np.array_equal(archive["T_world_grid"][:3, 3], FAR)
    assert np.array_equal(np.loadtxt(tmp_path / "out" / "offset.xyz"), FAR)
    assert "451200.0 5212300.0 500.0" in (tmp_path / "out" / "occupancy.yaml").read_text()


def test_distances_are_signed():
    state = np.full((12, 12, 12), FREE, np.uint8)
    state[3:8, 3:8, 3:8] = OCCUPIED
    state[11] = UNKNOWN
    found = signed_distances(state, 0.5, 2.0)
    assert found[5, 5, 5] == -1.0 and found[3, 5, 5] == 0.0 and found[2, 5, 5] == 0.5
    assert found[0, 0, 0] == pytest.approx(min(0.5 * np.sqrt(27), 2.0)) and found[11, 5, 5] == UNOBSERVED
    outside = 0.5 * distance_transform_edt(state != OCCUPIED)
    assert np.allclose(found[state == FREE], np.minimum(outside[state == FREE], 2.0))


def test_nothing_occupied_is_far_everywhere():
    assert (signed_distances(np.full((3, 4, 5), FREE, np.uint8), 0.1, 2.0) == 2.0).all()


def test_a_grid_that_is_too_large_names_the_size_that_fits(polarmap, run, tmp_path):
    ended = polarmap("export", run, "--to", "esdf", "-o", tmp_path / "out", "--voxel-size", 0.004)
    refused(ended, "voxels of 0.004 would take", "GB", "fits")
    assert not (tmp_path / "out").exists()
    size = float(ended.err.split("--voxel-size")[1].split()[0])
    make_grid(open_map(run), UP, size, 0.1)  # which is not refused


def test_an_interrupted_run_is_exported_with_a_voxel_of_the_median_depth(tmp_path, caplog):
    run = write_room(tmp_path / "run", finished=False)
    caplog.set_level(logging.WARNING)
    found = export_navigation(open_map(run), tmp_path / "out", UP)
    assert "not complete (interrupted)" in caplog.text
    median = np.median([np.nanmedian(k.depth) for k in room_keyframes()])
    assert found.grid.voxel_size == pytest.approx(0.02 * median)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--height", 1.0, 0.5], ["--height", "no band"]),
        (["--height", 7.0, 8.0], ["--height", "no voxel"]),
        (["--up", 0, 0, 0], ["--up"]),
        (["--min-confidence", 1], ["--min-confidence"]),
        (["--colour", "grey"], ["--colour", "glb"]),
    ],
)
def test_what_makes_no_sense_is_refused(polarmap, run, tmp_path, options, words):
    refused(polarmap("export", run, "--to", "esdf", "-o", tmp_path / "out", *options), *words)


def test_the_command_says_what_it_took(polarmap, run, tmp_path):
    ended = polarmap("export", run, "--to", "esdf", "-o", tmp_path / "out", "--voxel-size", 0.1)
    assert ended.status == 0
    assert "up: " in ended.out and "level surfaces" in ended.out and "--up X Y Z" in ended.out
    assert "floor at" in ended.out and "voxels of 0.1" in ended.out
