"""Keyframes as pieces of surface."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from polarmap.geometry.camera import PinholeCamera
from polarmap.viewer.patch import COLOURS, SHOWN, patch_of, surface, vertex_step

CAMERA = PinholeCamera(12, 8, 10.0, 10.0, 5.5, 3.5)


def test_vertices_are_where_their_pixels_say():
    z = np.full((4, 6), 2.0, np.float32)
    vertices, faces, kept = surface(z, CAMERA, 2)
    assert kept.all() and len(faces) == 2 * 3 * 5
    u = CAMERA.fx * vertices[:, 0] / vertices[:, 2] + CAMERA.cx
    v = CAMERA.fy * vertices[:, 1] / vertices[:, 2] + CAMERA.cy
    rows, columns = np.indices(z.shape)
    np.testing.assert_allclose(u, 2 * columns.ravel(), atol=1e-5)
    np.testing.assert_allclose(v, 2 * rows.ravel(), atol=1e-5)


def test_triangles_face_the_camera():
    vertices, faces, _ = surface(np.full((4, 6), 2.0, np.float32), CAMERA, 2)
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    assert (np.cross(b - a, c - a)[:, 2] < 0).all()


def test_no_triangle_spans_a_step_or_a_hole():
    z = np.full((5, 9), 2.0, np.float32)
    z[:, 4:] = 2.3
    z[0, 0] = np.nan
    vertices, faces, kept = surface(z, CAMERA, 1)
    corners = vertices[faces][:, :, 2]
    assert (corners.max(axis=1) - corners.min(axis=1) < 0.01).all()
    assert not kept[0, 0] and kept.sum() == len(vertices) == z.size - 1
    assert {2.0, 2.3} == set(np.round(vertices[:, 2].astype(float), 3))


def test_nothing_is_known_of_an_empty_keyframe():
    vertices, faces, kept = surface(np.full((4, 6), np.nan, np.float32), CAMERA, 2)
    assert len(vertices) == len(faces) == 0 and not kept.any()


@pytest.mark.parametrize(("size", "step"), [((160, 120), 1), ((640, 480), 4), ((1224, 1024), 9), ((64, 4000), 34)])
def test_patches_have_a_bounded_number_of_vertices(size, step):
    camera = PinholeCamera(*size, 500.0, 500.0, 1.0, 1.0)
    assert vertex_step(camera) == step


def test_a_keyframe_gives_colours_of_all_kinds_and_its_pictures(mapped_keyframe, ranges):
    patch = patch_of(mapped_keyframe, ranges)
    assert len(patch.vertices) > 1000
    assert set(patch.colours) == set(COLOURS) - {"age"} and set(patch.pictures) == set(SHOWN)
    for colours in patch.colours.values():
        assert colours.dtype == np.uint8 and colours.shape == patch.vertices.shape
    np.testing.assert_array_equal(patch.pose.rigid, mapped_keyframe.T_world_camera)


def test_normals_have_the_colours_of_their_directions_in_the_world(mapped_keyframe, ranges):
    turned = mapped_keyframe.T_world_camera @ np.diag([-1.0, -1.0, 1.0, 1.0])
    here, there = patch_of(mapped_keyframe, ranges), patch_of(replace(mapped_keyframe, T_world_camera=turned), ranges)
    assert (here.colours["grey"] == there.colours["grey"]).all()
    assert (here.colours["normal"] != there.colours["normal"]).any()
