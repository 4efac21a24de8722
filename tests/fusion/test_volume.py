"""Fusion on surfaces with known answers, and its promise that a depth map can be taken out again exactly."""

from __future__ import annotations

import itertools

import cv2
import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree

from polarmap.errors import InputError, PolarmapError
from polarmap.fusion import volume
from polarmap.fusion.block_index import BLOCK_SIDE, COORDINATE_LIMIT, coordinates
from polarmap.fusion.components import drop_small_components
from polarmap.fusion.depth_view import prepare_view
from polarmap.fusion.integration import ONE, touched_blocks
from polarmap.fusion.volume import TsdfVolume
from polarmap.fusion.voxel_size import choose_voxel_size
from polarmap.geometry.camera import PinholeCamera
from polarmap.geometry.pose import from_quaternion, look_at

CAMERA = PinholeCamera(96, 72, 80.0, 80.0, 47.5, 35.5)
GREY = np.full(CAMERA.shape, 0.5, np.float32)
VOXEL = 0.02


def plane_depth(distance: float = 1.0, slope: float = 0.0) -> np.ndarray:
    """Depth of the plane z = distance + slope·X in the camera frame."""
    return (distance / (1.0 - slope * CAMERA.normalized()[..., 0])).astype(np.float32)


def sphere_depth(T_world_camera: np.ndarray, radius: float) -> np.ndarray:
    """Depth of a sphere about the world's origin, seen from outside or inside, NaN beside it."""
    rays = CAMERA.rays().astype(float)
    centre = -T_world_camera[:3, :3].T @ T_world_camera[:3, 3]
    along = rays @ centre
    with np.errstate(invalid="ignore"):
        half_chord = np.sqrt(along**2 - centre @ centre + radius**2)
    distance = along + (half_chord if np.linalg.norm(centre) < radius else -half_chord)
    return (distance * rays[..., 2]).astype(np.float32)


def fuse_sphere(radius: float, camera_distance: float) -> TsdfVolume:
    """A sphere seen from 26 sides; a negative distance looks outward from within."""
    fused = TsdfVolume(VOXEL)
    for n, side in enumerate(itertools.product((-1.0, 0.0, 1.0), repeat=3)):
        if any(side):
            eye = camera_distance * np.array(side) / np.linalg.norm(side)
            T = look_at(eye, np.zeros(3), (0.0, 0.0, 1.0) if side[0] or side[1] else (1.0, 0.0, 0.0))
            if camera_distance < 0:
                T[:3, :3] @= np.diag([-1.0, 1.0, -1.0])
            fused.integrate(sphere_depth(T, radius), GREY, None, CAMERA, T, n)
    return fused


def noisy_frame(seed: int) -> tuple:
    """A rough surface with holes, random grey and confidence, and a pose of its own."""
    rng = np.random.default_rng(seed)
    depth = plane_depth(1.0, 0.3) + rng.normal(0.0, 0.02, CAMERA.shape).astype(np.float32)
    depth[rng.random(CAMERA.shape) < 0.2] = np.nan
    grey, confidence = rng.random((2, *CAMERA.shape)).astype(np.float32)
    T = look_at(rng.normal(0.0, 0.1, 3), np.array([0.0, 1.0, 0.1]))
    return depth, grey, confidence, CAMERA, T


def assert_same(a: TsdfVolume, b: TsdfVolume) -> None:
    for name in ("coordinates", "sums", "views"):
        assert np.array_equal(getattr(a.voxel_sums(), name), getattr(b.voxel_sums(), name)), name
    for name in ("vertices", "faces", "normals", "grey"):
        assert np.array_equal(getattr(a.mesh(), name), getattr(b.mesh(), name)), name


def face_normals(mesh) -> np.ndarray:
    a, b, c = (mesh.vertices[mesh.faces[:, n]].astype(float) for n in range(3))
    return np.cross(b - a, c - a)


@pytest.fixture(scope="module", params=["outside", "inside"])
def sphere(request):
    """(mesh of a sphere of radius 0.5, outward is +1 and inward -1)."""
    outside = request.param == "outside"
    return fuse_sphere(0.5, 1.5 if outside else -0.01).mesh(), 1 if outside else -1


def test_sphere_is_closed_with_shared_vertices(sphere):
    surface, side = sphere
    mesh = trimesh.Trimesh(surface.vertices, surface.faces, process=False)
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert mesh.euler_number == 2
    assert len(np.unique(surface.vertices, axis=0)) == len(surface.vertices)
    assert mesh.volume == pytest.approx(side * 4.0 / 3.0 * np.pi * 0.5**3, rel=0.02)


def test_sphere_is_where_it_should_be(sphere):
    surface, side = sphere
    offset = np.abs(np.linalg.norm(surface.vertices, axis=1) - 0.5)
    # from outside, voxels beyond the rim count as behind the thin slice in front of them, as always with projection
    assert np.median(offset) < (0.25 if side > 0 else 0.03) * VOXEL
    assert offset.max() < 0.6 * VOXEL


def test_sphere_normals_point_to_the_cameras(sphere):
    surface, side = sphere
    radial = side * surface.vertices / np.linalg.norm(surface.vertices, axis=1, keepdims=True)
    assert np.abs(np.linalg.norm(surface.normals, axis=1) - 1.0).max() < 1e-5
    assert np.median((surface.normals * radial).sum(1)) > 0.99
    assert (surface.normals * radial).sum(1).min() > 0.9
    assert ((face_normals(surface) * radial[surface.faces[:, 0]]).sum(1) > 0).all()


def test_slanted_plane_is_exact_and_faces_the_camera():
    fused = TsdfVolume(VOXEL)
    fused.integrate(plane_depth(1.0, 0.5), GREY, None, CAMERA, np.eye(4), 0)
    mesh = fused.mesh()
    offset = mesh.vertices[:, 2] - (1.0 + 0.5 * mesh.vertices[:, 0])
    assert np.median(np.abs(offset)) < 0.01 * VOXEL
    assert np.abs(offset).max() < 0.5 * VOXEL  # the outermost pixels have nothing to interpolate with
    assert np.median(mesh.normals @ (np.array([0.5, 0.0, -1.0]) / np.sqrt(1.25))) > 0.9999
    assert (face_normals(mesh)[:, 2] < 0).all()
    assert mesh.grey == pytest.approx(0.5, abs=1e-4)


def test_sums_agree_with_numpy():
    depth, grey, confidence = plane_depth(1.0, 0.4), *np.random.default_rng(0).random((2, *CAMERA.shape))
    T = look_at(np.array([0.3, -1.0, 0.2]), np.zeros(3))
    fused = TsdfVolume(VOXEL, 0.07)
    fused.integrate(depth, grey, confidence, CAMERA, T, "a")
    state = fused.voxel_sums()
    voxels = np.stack(np.meshgrid(*[np.arange(BLOCK_SIDE)] * 3, indexing="ij"), axis=-1)
    centres = (state.coordinates[:, None, None, None] * BLOCK_SIDE + voxels + 0.5) * VOXEL
    x, y, z = np.moveaxis((centres - T[:3, 3]) @ T[:3, :3], -1, 0)
    u, v = CAMERA.fx * x / z + CAMERA.cx, CAMERA.fy * y / z + CAMERA.cy
    inside = (z > 0) & (u > 0) & (v > 0) & (u < CAMERA.width - 1) & (v < CAMERA.height - 1)
    distance = (1.0 / (1.0 / 1.0 - 0.4 * (u - CAMERA.cx) / CAMERA.fx) - z) / 0.07
    column, row = (np.rint(np.where(inside, a, 0)).astype(int) for a in (u, v))
    weight = np.where(inside & (distance >= -1.0), confidence[row, column], 0.0)
    expected = np.stack([weight * np.minimum(distance, 1.0), weight, weight * grey[row, column]], axis=-1)
    surely = inside & (np.abs(distance + 1.0) > 1e-2) & (np.abs(np.abs(u % 1.0) - 0.5) > 1e-3)
    surely &= np.abs(np.abs(v % 1.0) - 0.5) > 1e-3
    assert surely.mean() > 0.5
    assert np.abs(state.sums / ONE - expected)[surely].max() < 2e-3


def test_touched_blocks_agree_with_dense_sampling():
    T = look_at(np.array([0.3, -1.0, 0.2]), np.zeros(3))
    view = prepare_view(plane_depth(1.0, 0.4), GREY, None, CAMERA, T)
    touched = coordinates(touched_blocks(view, VOXEL, 0.1, 10_000))
    z = view.depth[..., None] + np.linspace(-0.1, 0.1, 200)
    rays = np.concatenate([CAMERA.normalized(), np.ones((*CAMERA.shape, 1))], axis=-1) @ T[:3, :3].T
    points = T[:3, 3] + z[..., None] * rays[..., None, :]
    sampled = np.unique(np.floor(points / (BLOCK_SIDE * VOXEL)).astype(int).reshape(-1, 3), axis=0)
    touched, sampled = ({tuple(b) for b in blocks.tolist()} for blocks in (touched, sampled))
    assert len(sampled) > 100
    assert len(sampled - touched) <= 1  # a ray that ends on a border
    assert len(touched - sampled) <= 0.01 * len(touched)  # corners cut between two samples


def test_confidence_weighs():
    fused = TsdfVolume(VOXEL, 0.1)
    for n, (distance, confidence) in enumerate([(1.0, 0.9), (1.03, 0.3)]):
        fused.integrate(
            plane_depth(distance), np.full_like(GREY, n), np.full_like(GREY, confidence), CAMERA, np.eye(4), n
        )
    mesh = fused.mesh()
    assert np.median(mesh.vertices[:, 2]) == pytest.approx(1.0 + 0.03 * 0.3 / 1.2, abs=0.02 * VOXEL)
    assert np.median(mesh.grey) == pytest.approx(0.3 / 1.2, abs=1e-3)


def test_min_weight_keeps_what_was_seen_twice():
    fused = TsdfVolume(VOXEL)
    half = plane_depth()
    half[:, CAMERA.width // 2 :] = np.nan
    fused.integrate(plane_depth(), GREY, None, CAMERA, np.eye(4), 0)
    fused.integrate(half, GREY, None, CAMERA, np.eye(4), 1)
    assert fused.mesh().vertices[:, 0].max() > 0.5
    assert fused.mesh(min_weight=1.5).vertices[:, 0].max() < VOXEL
    assert len(fused.mesh(min_weight=2.5).faces) == 0
    with pytest.raises(InputError, match="min_weight"):
        fused.mesh(min_weight=-1.0)


def test_removal_is_exact():
    frames = [noisy_frame(seed) for seed in range(4)]
    fused, without = TsdfVolume(VOXEL), TsdfVolume(VOXEL)
    for n, frame in enumerate(frames):
        fused.integrate(*frame, n)
        if n != 1:
            without.integrate(*frame, n)
    fused.remove(*frames[1], 1)
    assert fused.frame_ids == (0, 2, 3)
    assert_same(fused, without)


def test_order_does_not_matter():
    frames = [noisy_frame(seed) for seed in range(3)]
    forward, backward = TsdfVolume(VOXEL), TsdfVolume(VOXEL)
    for n in range(3):
        forward.integrate(*frames[n], n)
        backward.integrate(*frames[2 - n], 2 - n)
    assert_same(forward, backward)


def test_blocks_of_removed_frames_are_freed_and_reused():
    fused = TsdfVolume(VOXEL)
    for n in range(6):
        depth, *rest, T = noisy_frame(n)
        T[:3, 3] += 10.0 * n
        fused.integrate(depth, *rest, T, n)
        if n == 0:
            count, size = fused.block_count, fused.bytes
        fused.remove(depth, *rest, T, n)
        assert fused.block_count == 0
    assert fused.bytes < 2 * size
    assert count > 100


def test_a_frame_is_removed_only_with_its_own_data():
    fused, (depth, grey, confidence, camera, T) = TsdfVolume(VOXEL), noisy_frame(0)
    fused.integrate(depth, grey, confidence, camera, T, 7)
    before = fused.voxel_sums().sums
    with pytest.raises(InputError, match="frame 7 is in the volume already"):
        fused.integrate(depth, grey, confidence, camera, T, 7)
    with pytest.raises(InputError, match="frame 8 is not in the volume"):
        fused.remove(depth, grey, confidence, camera, T, 8)
    moved = T.copy()
    moved[0, 3] += 1e-9
    for wrong in [(depth + 1, grey, confidence, camera, T), (depth, grey, None, camera, T)]:
        with pytest.raises(InputError, match="frame 7 was integrated with another"):
            fused.remove(*wrong, 7)
    with pytest.raises(InputError, match="frame 7 was integrated with another"):
        fused.remove(depth, grey, confidence, camera, moved, 7)
    assert np.array_equal(fused.voxel_sums().sums, before)


def test_missing_and_absurd_pixels_leave_no_trace():
    depth, confidence = plane_depth(), np.ones_like(GREY)
    bad_depth, bad_confidence = depth.copy(), confidence.copy()
    for row, value in enumerate((np.nan, np.inf, -np.inf, 0.0, -1.0)):
        depth[row], bad_depth[row] = np.nan, value
    for row, value in enumerate((np.nan, 0.0, -1.0), start=10):
        depth[row], bad_confidence[row] = np.nan, value
    clean, dirty = TsdfVolume(VOXEL), TsdfVolume(VOXEL)
    clean.integrate(depth, GREY, confidence, CAMERA, np.eye(4), 0)
    dirty.integrate(bad_depth, GREY, bad_confidence, CAMERA, np.eye(4), 0)
    assert_same(clean, dirty)


def test_depth_beyond_the_addressable_blocks_makes_none_and_is_said(caplog):
    depth = plane_depth()
    depth[10:12] = 1e30
    expected, fused = TsdfVolume(VOXEL), TsdfVolume(VOXEL)
    expected.integrate(np.where(depth < 1e30, depth, np.float32(np.nan)), GREY, None, CAMERA, np.eye(4), 0)
    fused.integrate(depth, GREY, None, CAMERA, np.eye(4), 0)
    assert np.array_equal(expected.voxel_sums().coordinates, fused.voxel_sums().coordinates)
    assert (expected.left_out, fused.left_out) == (0, 2 * CAMERA.width)
    fused.integrate(depth, GREY, None, CAMERA, np.eye(4), 1)
    assert fused.left_out == 4 * CAMERA.width
    assert len(caplog.records) == 1
    assert f"frame 0: {2 * CAMERA.width} of its points are left out" in caplog.text
    for frame in (0, 1):
        fused.remove(depth, GREY, None, CAMERA, np.eye(4), frame)
    assert fused.left_out == 0


def test_grey_and_confidence_are_clipped():
    expected, fused = TsdfVolume(VOXEL), TsdfVolume(VOXEL)
    expected.integrate(plane_depth(), np.ones_like(GREY), None, CAMERA, np.eye(4), 0)
    fused.integrate(plane_depth(), np.full_like(GREY, 9.0), np.full_like(GREY, 5.0), CAMERA, np.eye(4), 0)
    assert_same(expected, fused)


def test_nothing_in_nothing_out():
    fused = TsdfVolume(VOXEL)
    fused.integrate(np.full_like(GREY, np.nan), GREY, None, CAMERA, np.eye(4), 0)
    assert fused.block_count == 0
    assert fused.mesh(min_faces=10).faces.shape == (0, 3)
    assert fused.points().points.shape == (0, 3)
    fused.remove(np.full_like(GREY, np.nan), GREY, None, CAMERA, np.eye(4), 0)


def test_memory_is_bounded():
    fused = TsdfVolume(VOXEL, max_blocks=200)
    fused.integrate(plane_depth(), GREY, None, CAMERA, np.eye(4), 0)
    assert fused.bytes <= 200 * 6144 + 100_000
    T = np.eye(4)
    T[0, 3] = 100.0
    before = fused.voxel_sums()
    for depth in (plane_depth(), plane_depth(20.0)):
        with pytest.raises(PolarmapError, match=r"more than 200 blocks of voxels of 0\.02 m; use a larger"):
            fused.integrate(depth, GREY, None, CAMERA, T, 1)
    assert fused.frame_ids == (0,)
    assert np.array_equal(fused.voxel_sums().sums, before.sums)


def test_sums_cannot_overflow(monkeypatch):
    monkeypatch.setattr(volume, "MAX_VIEWS_PER_BLOCK", 2)
    fused = TsdfVolume(VOXEL)
    for n in range(2):
        fused.integrate(plane_depth(), GREY, None, CAMERA, np.eye(4), n)
    with pytest.raises(PolarmapError, match="more than 2 depth maps on one block"):
        fused.integrate(plane_depth(), GREY, None, CAMERA, np.eye(4), 2)


@pytest.mark.parametrize("centre", [(-5000.0, 3000.0, -700.0), (1e5, 1e5, 1e5)])
def test_far_from_the_origin(centre):
    T = np.eye(4)
    T[:3, 3] = centre
    fused = TsdfVolume(0.25)
    fused.integrate(plane_depth(10.0), GREY, None, CAMERA, T, 0)
    z = fused.mesh().vertices[:, 2].astype(float)
    assert len(z) > 1000
    assert np.abs(z - (centre[2] + 10.0)).max() < 0.05 * 0.25


@pytest.mark.parametrize("distance", [1e9, 1e300])
def test_a_camera_beyond_the_addressable_blocks_adds_nothing_and_is_said(caplog, distance):
    T = np.eye(4)
    T[1, 3] = distance
    fused = TsdfVolume(VOXEL)
    fused.integrate(plane_depth(), GREY, None, CAMERA, T, "lost")
    assert fused.block_count == 0
    assert fused.left_out == np.isfinite(plane_depth()).sum()
    assert "frame lost" in caplog.text
    assert "voxel_size" in caplog.text


def test_points_are_left_out_at_the_very_border():
    """Just what the kernel leaves out is counted."""
    border = (COORDINATE_LIMIT - 2) * 8 * VOXEL
    T = np.eye(4)
    T[0, 3] = border
    inside, fused = TsdfVolume(VOXEL), TsdfVolume(VOXEL)
    fused.integrate(plane_depth(), GREY, None, CAMERA, T, 0)
    left = plane_depth()
    left[:, int(np.ceil(CAMERA.cx)) :] = np.nan  # on the right of the image x grows
    inside.integrate(left, GREY, None, CAMERA, T, 0)
    assert fused.block_count == inside.block_count > 0
    assert inside.left_out == 0
    assert fused.left_out == np.isfinite(plane_depth()).sum() - np.isfinite(left).sum()


def test_points_contain_the_mesh_vertices():
    fused = TsdfVolume(VOXEL)
    fused.integrate(*noisy_frame(0), 0)
    cloud, mesh = fused.points(), fused.mesh()
    points = {p.tobytes() for p in cloud.points}
    assert len(cloud.points) == len(cloud.normals) == len(cloud.grey) > len(mesh.vertices)
    assert all(vertex.tobytes() in points for vertex in mesh.vertices)
    assert np.array_equal(np.unique(mesh.faces), np.arange(len(mesh.vertices)))


def test_small_pieces_are_dropped():
    depth = plane_depth()
    depth[:, 60:70] = np.nan
    depth[:, 76:] = np.nan
    fused = TsdfVolume(VOXEL)
    fused.integrate(depth, GREY, None, CAMERA, np.eye(4), 0)
    whole, cleaned = fused.mesh(), fused.mesh(min_faces=1000)
    strip = whole.vertices[:, 0] > 0.2
    assert 0 < strip.sum() == len(whole.vertices) - len(cleaned.vertices)
    assert cleaned.vertices[:, 0].max() < 0.2
    assert np.array_equal(np.unique(cleaned.faces), np.arange(len(cleaned.vertices)))
    assert len(drop_small_components(whole, 10**6).vertices) == 0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"depth": np.ones((3, 4))}, "depth is"),
        ({"grey": np.ones((3, 4))}, "grey is"),
        ({"confidence": np.ones((3, 4))}, "confidence is"),
        ({"T_world_camera": np.full((4, 4), np.nan)}, "4x4 and finite"),
        ({"T_world_camera": np.eye(3)}, "4x4 and finite"),
        ({"T_world_camera": 2.0 * np.eye(4)}, "not a rigid motion"),
        ({"T_world_camera": np.diag([-1.0, 1.0, 1.0, 1.0])}, "not a rigid motion"),
    ],
)
def test_bad_input_is_refused(change, message):
    arguments = {"depth": plane_depth(), "grey": GREY, "confidence": None, "T_world_camera": np.eye(4)} | change
    with pytest.raises(InputError, match=message):
        TsdfVolume(VOXEL).integrate(**arguments, camera=CAMERA, frame_id=0)


@pytest.mark.parametrize(
    "arguments", [(0.0,), (np.nan,), (-1.0,), (0.1, 0.05), (0.1, 100.0), (0.1, np.nan), (0.1, 0.5, 0)]
)
def test_bad_parameters_are_refused(arguments):
    with pytest.raises(InputError, match="fusion: "):
        TsdfVolume(*arguments)


def test_voxel_size_follows_the_depth():
    assert choose_voxel_size(plane_depth(1.0), CAMERA) == pytest.approx(2.0 / 80.0)
    assert choose_voxel_size(plane_depth(7.0), CAMERA) == pytest.approx(7.0 * 2.0 / 80.0)
    sharp = PinholeCamera(96, 72, 8000.0, 8000.0, 47.5, 35.5)
    assert choose_voxel_size(plane_depth(2.0), sharp) == pytest.approx(0.01)


def test_voxel_size_bounds_the_blocks():
    depth = plane_depth()
    depth[:30] *= np.linspace(50.0, 1000.0, 30 * 96).reshape(30, 96)
    size = choose_voxel_size(depth, CAMERA, max_blocks_per_view=2000)
    assert size > 0.05
    fused = TsdfVolume(size, max_blocks=2000)
    fused.integrate(depth, GREY, None, CAMERA, np.eye(4), 0)
    with pytest.raises(InputError, match="without depth"):
        choose_voxel_size(np.full_like(depth, np.nan), CAMERA)
    with pytest.raises(InputError, match="at least 1000"):
        choose_voxel_size(depth, CAMERA, max_blocks_per_view=1)


def test_rendered_room_agrees_with_frames_left_out(shared_data):
    """The fused surface passes through the true depth of other frames to within a tenth of a voxel."""
    camera = PinholeCamera(640, 480, 480.0, 480.0, 319.5, 239.5)
    poses = np.loadtxt(shared_data / "livingroom" / "groundtruth.txt")

    def frame(n: int) -> tuple[np.ndarray, np.ndarray]:
        depth = cv2.imread(str(shared_data / f"livingroom/depth/{n:06d}.png"), cv2.IMREAD_UNCHANGED) / 5000.0
        return np.where(depth > 0, depth, np.nan), from_quaternion(poses[n, 1:4], poses[n, 4:])

    fused = TsdfVolume(VOXEL, 0.1)
    for n in range(0, 16, 4):
        depth, T = frame(n)
        fused.integrate(depth, np.zeros_like(depth), None, camera, T, n)
    cloud = fused.points()
    depth, T = frame(6)
    points = (camera.normalized() * depth[..., None])[::6, ::6].reshape(-1, 2)
    points = np.column_stack([points, depth[::6, ::6].ravel()]) @ T[:3, :3].T + T[:3, 3]
    points = points[np.isfinite(points).all(1)]
    distance, nearest = cKDTree(cloud.points).query(points)
    offset = np.abs(((points - cloud.points[nearest]) * cloud.normals[nearest]).sum(1))
    assert np.mean(distance < 2 * VOXEL) > 0.97
    assert np.median(offset) < 0.03 * VOXEL
    assert np.mean(offset < 0.1 * VOXEL) > 0.8
