"""The whole pipeline on the built-in room: dense, exact, and never worse than stereo alone."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
import pytest
from room_recording import CAMERA, FILE, Recording, raw, recorded_room
from scenes import MATERIALS, WIDE, moved, plane_depth, polarization_of, turned
from scipy.spatial import cKDTree

from polarmap.data.codes import Origin, Reflection
from polarmap.data.keyframe import Keyframe
from polarmap.data.map import Map
from polarmap.data.polarization_image import PolarizationImage
from polarmap.densify.options import DensifyOptions
from polarmap.errors import InputError
from polarmap.fusion.options import FusionOptions
from polarmap.fusion.surface_map import SurfaceMap
from polarmap.geometry.origin import shifted
from polarmap.pipeline.config import Config
from polarmap.pipeline.mapper import Mapper
from polarmap.prior.priors import PriorDepth
from polarmap.synth import render, scenes
from polarmap.timing import StepClock

KEYFRAMES = [0, 3, 6, 9]


@pytest.fixture(scope="module")
def recording() -> Recording:
    return recorded_room()


PAPER = Config(densify=DensifyOptions(method="paper"))


def mapped(recording: Recording, prior=None, spoil=lambda image: image, config=None) -> tuple[list[Keyframe], Map]:
    """The keyframes and the map of the recording given as arrays, each image spoiled first."""
    keyframes: list[Keyframe] = []
    mapper = Mapper(CAMERA, prior=prior, config=config, on_keyframe=keyframes.append)
    for frame, image in zip(recording.frames, recording.images, strict=True):
        mapper.process_image(spoil(image), frame.T_world_camera, frame.timestamp, frame.index)
    return keyframes, mapper.finish()


@pytest.fixture(scope="module")
def room(recording) -> tuple[list[Keyframe], Map]:
    return mapped(recording)


def error(keyframe: Keyframe, recording: Recording, depth=None) -> np.ndarray:
    """Relative error of depth, the keyframe's own if not given, H×W with NaN."""
    depth = keyframe.depth if depth is None else depth
    return np.abs(depth / recording.frames[keyframe.index].truth.depth - 1)


def mean_error(keyframes, recording, pick) -> float:
    return float(np.mean([np.nanmean(error(k, recording, pick(k))) for k in keyframes]))


def mean_density(keyframes, pick) -> float:
    return float(np.mean([np.isfinite(pick(k)).mean() for k in keyframes]))


def test_the_room_is_mapped_densely_and_well(room, recording):
    keyframes, _ = room
    assert [k.index for k in keyframes] == KEYFRAMES
    steps = {
        "stereo": (lambda k: k.stages.stereo, 0.030, 0.25),
        "inliers": (lambda k: k.stages.inliers, 0.025, 0.20),
        "first": (lambda k: k.stages.first, 0.080, 0.99),
        "end": (lambda k: k.depth, 0.080, 0.99),
    }
    for pick, largest_error, least_density in steps.values():
        assert mean_error(keyframes, recording, pick) < largest_error
        assert mean_density(keyframes, pick) > least_density
    right = np.mean([(error(k, recording) < 0.02).mean() for k in keyframes])
    assert right > np.mean([(error(k, recording, k.stages.stereo) < 0.02).mean() for k in keyframes]) + 0.08


def test_the_papers_loop_maps_the_room(recording):
    keyframes, _ = mapped(recording, config=PAPER)
    assert mean_error(keyframes, recording, lambda k: k.stages.first) < 0.045
    assert mean_density(keyframes, lambda k: k.stages.first) > 0.40
    assert mean_error(keyframes, recording, lambda k: k.depth) < 0.080
    assert mean_density(keyframes, lambda k: k.depth) > 0.65
    for keyframe in keyframes:
        np.testing.assert_array_equal(keyframe.origin == Origin.STEREO, np.isfinite(keyframe.stages.inliers))


def test_a_keyframe_says_all_about_itself(room, recording):
    for keyframe in room[0]:
        known = np.isfinite(keyframe.depth)
        frame = recording.frames[keyframe.index]
        np.testing.assert_array_equal(keyframe.T_world_camera, frame.T_world_camera)
        assert keyframe.timestamp == frame.timestamp and keyframe.camera == CAMERA
        assert keyframe.density == known.mean()
        np.testing.assert_array_equal(keyframe.origin > Origin.NONE, known)
        stereo = keyframe.origin == Origin.STEREO
        agreement = np.abs(keyframe.stages.inliers / keyframe.depth - 1.0)
        np.testing.assert_array_equal(stereo, agreement < 0.015)
        assert (keyframe.confidence[~known] == 0).all() and (keyframe.confidence[known] > 0).all()
        assert keyframe.confidence[stereo].mean() > 2 * keyframe.confidence[known & ~stereo].mean()
        np.testing.assert_array_equal(np.isfinite(keyframe.sigma), known)
        assert keyframe.sigma[known].min() > 0
        order = np.argsort(keyframe.sigma[known])
        assert (np.diff(keyframe.confidence[known][order]) <= 0).all() and keyframe.confidence.max() <= 1.0
        np.testing.assert_array_equal(np.isfinite(keyframe.azimuth), keyframe.label > Reflection.NONE)
        lengths = np.linalg.norm(keyframe.normal, axis=-1)
        np.testing.assert_allclose(lengths[np.isfinite(lengths)], 1.0, atol=1e-5)
        assert keyframe.prior_verdict and keyframe.milliseconds["stereo"] > 0
        for array in (keyframe.depth, keyframe.normal, keyframe.azimuth, keyframe.zenith, keyframe.confidence):
            assert array.dtype == np.float32
        assert keyframe.label.dtype == keyframe.origin.dtype == np.uint8


def test_the_map_counts_and_holds_the_surface(room, recording):
    _, result = room
    assert (result.frames, result.posed, result.keyframes) == (11, 11, 4)
    assert 0.01 < result.voxel_size < 0.2 and result.blocks > 50
    assert {"stereo", "densify", "fusion", "mesh"} <= set(result.milliseconds)
    assert len(result.mesh.faces) > 1000 and len(result.cloud.points) > 1000
    half_room = np.array([2.5, 2.5, 1.25])
    beyond = (np.abs(result.mesh.vertices - [0.0, 0.0, 1.25]) - half_room).max(axis=1)
    assert np.quantile(beyond, 0.75) < 0.1  # metres outside the walls


def test_frames_and_images_give_the_same_map(recording, room):
    keyframes: list[Keyframe] = []
    mapper = Mapper(FILE, recording.poses.get, on_keyframe=keyframes.append)
    returned = [mapper.process(raw(frame)) for frame in recording.frames]
    assert [k.index for k in returned if k is not None] == [k.index for k in keyframes] == KEYFRAMES[: len(keyframes)]
    assert mapper.finish().keyframes == mapper.keyframe_count == len(keyframes) == 4
    for a, b in zip(keyframes, room[0], strict=True):
        np.testing.assert_array_equal(a.depth, b.depth)
        np.testing.assert_array_equal(a.label, b.label)


def test_the_map_is_the_same_anywhere(recording, room):
    """UTM metres: the same depth to the last bit, and the same surface, counted from an origin nearby."""
    place = np.array([451234.5, 5212345.678, 512.3])
    far = {t: shifted(T, place) for t, T in recording.poses.items()}
    keyframes: list[Keyframe] = []
    mapper = Mapper(CAMERA, far.get, on_keyframe=keyframes.append)
    for frame, image in zip(recording.frames, recording.images, strict=True):
        mapper.process_image(image, None, frame.timestamp, frame.index)
    result = mapper.finish()
    np.testing.assert_array_equal(result.origin, [451200.0, 5212300.0, 500.0])
    np.testing.assert_array_equal(room[1].origin, 0.0)
    assert [k.index for k in keyframes] == KEYFRAMES
    for ours, near in zip(keyframes, room[0], strict=True):
        np.testing.assert_array_equal(ours.T_world_camera, far[ours.timestamp])
        for name in ("depth", "normal", "confidence", "label"):
            np.testing.assert_array_equal(getattr(ours, name), getattr(near, name))
    assert (result.voxel_size, result.left_out) == (room[1].voxel_size, 0)
    for points, expected in (
        (result.mesh.vertices, room[1].mesh.vertices),
        (result.cloud.points, room[1].cloud.points),
    ):
        assert points.dtype == expected.dtype == np.float32
        assert len(points) == pytest.approx(len(expected), rel=1e-3)  # a sum may be rounded the other way
        assert np.quantile(cKDTree(expected + place).query(points + result.origin)[0], 0.999) < 1e-4


def test_a_place_that_double_precision_cannot_tell_is_refused(recording):
    mapper = Mapper(CAMERA)
    with pytest.raises(InputError, match=r"frame 2: .* 1e\+17 from the origin, where numbers are 16 apart"):
        mapper.process_image(recording.images[0], shifted(np.eye(4), np.array([0, 1e17, 0])), 0.0, 2)


def test_frames_without_a_pose_are_counted_and_left_out(recording):
    poses = {t: T for t, T in recording.poses.items() if t > recording.frames[6].timestamp}
    mapper = Mapper(FILE, poses.get)
    for frame in recording.frames:
        mapper.process(raw(frame))
    result = mapper.finish()
    assert (result.frames, result.posed) == (11, 4) and result.keyframes == 2


def test_without_frames_the_map_is_empty():
    result = Mapper(CAMERA).finish()
    assert result.mesh is None and result.cloud is None and result.voxel_size is None
    assert (result.frames, result.posed, result.keyframes, result.blocks) == (0, 0, 0, 0)


def test_memory_does_not_grow_with_the_frames(recording):
    """Views are held while stereo may look at them, however many came: here every frame is a keyframe."""
    mapper = Mapper(CAMERA, config=Config().with_settings(["keyframes.flow_weight=10"]))
    held = []
    for frame, image in zip(recording.frames, recording.images, strict=True):
        mapper.process_image(image, frame.T_world_camera, frame.timestamp, frame.index)
        held.append(len(mapper._segment.pending) + len(mapper._segment.mapped))
    assert mapper.keyframe_count > 7
    assert max(held) <= 7 and held[7:] == held[7:8] * len(held[7:]) and len(held) > 9


@pytest.mark.parametrize("future", [0, 1, 2])
def test_a_keyframe_waits_for_later_ones_and_the_first_for_two_neighbours(recording, future):
    """Three keyframes come, then frames that are none."""
    mapper = Mapper(CAMERA, config=Config().with_settings([f"stereo.future={future}"]))
    done = []
    for now, source in enumerate((0, 3, 6, 6, 6, 6)):
        keyframe = mapper.process_image(recording.images[source], recording.frames[source].T_world_camera, now, now)
        done.append(keyframe and keyframe.index)
    assert done == [None, None, *([0, 1, 2] + [None] * 3)[: 3 - future], *[None] * (1 + future)]
    assert mapper.finish().keyframes == 3


def test_without_neighbours_there_is_no_stereo(recording):
    keyframes, _ = mapped(recording, config=Config().with_settings(["stereo.past=0", "stereo.future=0"]))
    assert all(np.isnan(k.stages.stereo).all() for k in keyframes)


def test_a_camera_that_only_turns_gives_no_depth(recording):
    """Nothing is invented, nothing fails, and keyframes still come."""
    keyframes: list[Keyframe] = []
    mapper = Mapper(CAMERA, on_keyframe=keyframes.append)
    for index in range(3):
        T = recording.frames[0].T_world_camera @ turned((0.0, 0.15 * index + 1e-9, 0.0))
        mapper.process_image(recording.images[index], T, 0.1 * index, index)
    result = mapper.finish()
    assert [k.index for k in keyframes] == [0, 1, 2]
    assert all(np.isnan(k.depth).all() and k.density == 0 for k in keyframes)
    assert result.mesh is None and result.keyframes == 3


def test_one_frame_gives_a_keyframe_without_depth(recording):
    mapper = Mapper(CAMERA)
    mapper.process_image(recording.images[0], np.eye(4), 0.0, 0)
    result = mapper.finish()
    assert result.keyframes == 1 and result.mesh is None


def test_a_bare_wall_gives_no_depth():
    wall = scenes.plane(MATERIALS["matte"], tilt=0.2)
    mapper = Mapper(WIDE)
    keyframes = []
    for index, x in enumerate((0.0, 0.15, 0.3)):
        image = polarization_of(render(wall, WIDE, moved(x)), seed=index)
        keyframes.append(mapper.process_image(image, moved(x), 0.1 * index, index))
    mapper.finish()
    assert all(k.density < 0.01 for k in keyframes if k is not None)


def test_a_bare_picture_that_does_not_move_is_one_keyframe(recording):
    flat = replace(recording.images[0], intensity=np.full(CAMERA.shape, 0.5, np.float32))
    mapper = Mapper(CAMERA)
    for index in range(4):
        mapper.process_image(flat, np.eye(4), 0.1 * index, index)
    assert mapper.finish().keyframes == 1


def prior_that(depth_of):
    """A prior that gives this depth, from the sparse points, whatever it is worth."""

    def prior(image, sparse, camera, hurry) -> PriorDepth:
        depth = depth_of(sparse).astype(np.float32)
        with np.errstate(divide="ignore"):
            return PriorDepth(depth, 1.0 / depth, "test", "test")

    return prior


USELESS_PRIORS = {
    "nan": lambda sparse: np.full(sparse.shape, np.nan),
    "constant": lambda sparse: np.full(sparse.shape, 2.0),
    "noise": lambda sparse: np.random.default_rng(0).uniform(1.0, 4.0, sparse.shape),
    "half of one": lambda sparse: np.where(np.arange(160) < 80, plane_depth(CAMERA, (0.1, 0.6, -1.0), 3.0), np.nan),
    "inverted": lambda sparse: 6.0 - plane_depth(CAMERA, (0.1, 0.6, -1.0), 3.0).clip(1, 5),
}


def every_pixel(**values):
    return lambda image: replace(image, **{name: np.full_like(getattr(image, name), v) for name, v in values.items()})


def random_angles(image: PolarizationImage) -> PolarizationImage:
    rng = np.random.default_rng(0)
    aolp, dolp = (rng.random((2, *CAMERA.shape)) * [[[np.pi]], [[1.0]]]).astype(np.float32)
    return every_pixel(sigma_aolp=0.01)(replace(image, aolp=aolp, dolp=dolp))


DEGENERATE = {
    "no polarization": every_pixel(dolp=0.0, aolp=0.0, sigma_aolp=0.9),
    "none, and said to be exact": every_pixel(dolp=0.0, aolp=0.0, sigma_aolp=0.0, sigma_dolp=0.0),
    "over 1": every_pixel(dolp=1.5, sigma_aolp=0.01),
    "saturated": every_pixel(saturated=True),
    "underexposed": every_pixel(underexposed=True),
    "random": random_angles,
}


def assert_no_worse_than_stereo(keyframes, recording):
    """Every stereo point is there and as good as before; as many pixels are right as stereo alone had right."""
    for keyframe in keyframes:
        sure = np.isfinite(keyframe.stages.inliers)
        assert np.isfinite(keyframe.depth[sure]).all()
    at_stereo = mean_error(keyframes, recording, lambda k: np.where(np.isfinite(k.stages.inliers), k.depth, np.nan))
    assert at_stereo < 1.02 * mean_error(keyframes, recording, lambda k: k.stages.inliers)
    for threshold in (0.02, 0.05):
        right, before = (
            np.mean([(error(k, recording, pick(k)) < threshold).mean() for k in keyframes])
            for pick in (lambda k: k.depth, lambda k: k.stages.inliers)
        )
        assert right > before


@pytest.mark.parametrize("prior", USELESS_PRIORS)
def test_a_useless_prior_makes_nothing_worse(recording, prior):
    keyframes, _ = mapped(recording, prior=prior_that(USELESS_PRIORS[prior]))
    assert [k.index for k in keyframes] == KEYFRAMES
    assert_no_worse_than_stereo(keyframes, recording)


@pytest.fixture(scope="module")
def without_polarization(recording) -> list[Keyframe]:
    return mapped(recording, spoil=DEGENERATE["no polarization"])[0]


@pytest.mark.parametrize("pixels", DEGENERATE)
def test_degenerate_polarization_makes_nothing_worse(recording, without_polarization, pixels):
    keyframes, _ = mapped(recording, spoil=DEGENERATE[pixels])
    assert_no_worse_than_stereo(keyframes, recording)
    # Angles that contradict themselves from pixel to pixel, and claim to be exact, mislead the prior's network, too.
    assert_no_worse_than(without_polarization, keyframes, recording, 1.4 if pixels == "random" else 1.2)


def test_polarization_does_not_make_the_room_worse(recording, room, without_polarization):
    assert_no_worse_than(without_polarization, room[0], recording)


def assert_no_worse_than(others, keyframes, recording, factor=1.2):
    assert mean_density(keyframes, lambda k: k.depth) > 0.85 * mean_density(others, lambda k: k.depth)
    ours, theirs = (mean_error(k, recording, lambda k: k.depth) for k in (keyframes, others))
    assert ours < factor * theirs


def test_black_frames_give_no_depth(recording):
    keyframes, result = mapped(recording, spoil=every_pixel(intensity=0.0, dolp=0.0, sigma_aolp=0.9, underexposed=True))
    assert all(k.density == 0 for k in keyframes) and result.mesh is None


def test_what_does_not_fit_is_refused(recording):
    image = recording.images[0]
    with pytest.raises(InputError, match="needs a camera file and poses"):
        Mapper(CAMERA).process(raw(recording.frames[0]))
    with pytest.raises(InputError, match="needs a camera file and poses"):
        Mapper(FILE).process(raw(recording.frames[0]))
    with pytest.raises(InputError, match=r"frame 7: image \(120, 160\) does not fit the camera \(90, 120\)"):
        Mapper(WIDE).process_image(image, np.eye(4), 0.0, 7)
    with pytest.raises(InputError, match=r"000000\.png"):
        Mapper(FILE, recording.poses.get).process(replace(raw(recording.frames[0]), mosaic=np.zeros((9, 9), np.uint16)))


BAD_POSES = {
    "nan": np.diag([np.nan, 1, 1, 1]),
    "mirrored": np.diag([1.0, 1, -1, 1]),
    "scaled": np.diag([2.0, 2, 2, 1]),
    "3x4": np.eye(4)[:3],
}


@pytest.mark.parametrize("pose", BAD_POSES)
def test_a_pose_that_is_no_motion_is_refused(recording, pose):
    mapper = Mapper(CAMERA)
    with pytest.raises(InputError, match="frame 3: its pose"):
        mapper.process_image(recording.images[0], BAD_POSES[pose], 0.0, 3)
    assert mapper.finish().keyframes == 0


def test_a_stretched_pose_is_refused(recording):
    with pytest.raises(InputError):
        Mapper(CAMERA).process_image(recording.images[0], np.diag([2.0, 0.5, 1.0, 1.0]), 0.0, 0)


def test_what_was_mapped_stays_after_bad_input(recording):
    mapper = Mapper(CAMERA)
    for frame, image in list(zip(recording.frames, recording.images, strict=True))[:7]:
        mapper.process_image(image, frame.T_world_camera, frame.timestamp, frame.index)
    with pytest.raises(InputError):
        mapper.process_image(recording.images[7], BAD_POSES["nan"], 0.0, 7)
    assert mapper.finish().keyframes == 3


def a_depth_map(seed=0) -> tuple:
    """Depth, grey, confidence, camera and pose, as `SurfaceMap` takes them."""
    confidence = np.random.default_rng(seed).uniform(0.0, 1.0, WIDE.shape).astype(np.float32)
    depth = plane_depth(WIDE, (0.2, 0.1, -1.0), 2.0).astype(np.float32)
    return depth, np.full(WIDE.shape, 0.5, np.float32), confidence, WIDE, moved(0.01 * seed)


def test_a_surface_map_starts_with_the_first_depth():
    surface = SurfaceMap()
    assert surface.mesh() is None and surface.points() is None
    nothing = (np.full(WIDE.shape, np.nan, np.float32), *a_depth_map()[1:])
    assert not surface.integrate(*nothing, 0) and surface.volume is None
    assert surface.integrate(*a_depth_map(), 1)
    given = SurfaceMap(FusionOptions(voxel_size=0.05, truncation=0.2))
    given.integrate(*a_depth_map(), 0)
    assert (given.volume.voxel_size, given.volume.truncation) == (0.05, 0.2) != surface.volume.voxel_size


def test_a_depth_map_can_be_taken_out_of_the_surface_map():
    options = FusionOptions(voxel_size=0.05)
    one, both = SurfaceMap(options), SurfaceMap(options)
    one.integrate(*a_depth_map(0), 0)
    both.integrate(*a_depth_map(0), 0)
    both.integrate(*a_depth_map(1), 1)
    both.remove(*a_depth_map(1), 1)
    both.remove(*a_depth_map(2), 2)  # was never in
    a, b = one.volume.voxel_sums(), both.volume.voxel_sums()
    np.testing.assert_array_equal(a.coordinates, b.coordinates)
    np.testing.assert_array_equal(a.sums, b.sums)


def test_pixels_of_little_confidence_are_not_fused():
    depth, grey, _, camera, T = a_depth_map()
    half = np.where(np.arange(WIDE.width) < 60, np.float32(0.5), np.float32(0.05)) * np.ones(WIDE.shape, np.float32)
    surface = SurfaceMap(FusionOptions(voxel_size=0.05, min_confidence=0.1, min_weight=0.0))
    surface.integrate(depth, grey, half, camera, T, 0)
    assert surface.points().points[:, 0].max() < 0.1
    assert not SurfaceMap().integrate(depth, grey, 0.1 * half, camera, T, 0)


def test_the_clock_adds_up_steps_even_if_one_fails():
    clock, total = StepClock(), StepClock()
    for _ in range(2):
        with clock("sleep"):
            time.sleep(0.01)
    with pytest.raises(KeyError), clock("fail"):
        raise KeyError
    assert 20 <= clock.milliseconds["sleep"] < 200 and clock.milliseconds["fail"] >= 0
    total.add(clock.milliseconds)
    total.add({"sleep": 1.0, "other": 2.0})
    assert total.milliseconds["sleep"] == pytest.approx(clock.milliseconds["sleep"] + 1.0)
    assert total.milliseconds["other"] == 2.0
