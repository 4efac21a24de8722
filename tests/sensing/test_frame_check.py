"""Which pictures are unfit to be mapped, and which only look odd."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from polarmap.data.sensor import SensorNoise
from polarmap.sensing.frame_check import Fault, FrameCheck
from polarmap.sensing.frame_look import FrameLooker, cell_means

SENSOR = SensorNoise()
HEIGHT, WIDTH = 120, 160
PERIOD = 1 / 30
COUNT = 9


def texture(seed: int = 0, smallest: float = 1.2) -> np.ndarray:
    """A large picture with detail of all sizes, float32 in [0.05, 0.42]."""
    rng = np.random.default_rng(seed)
    scales = [smallest * 2**i for i in range(5)]
    noise = (rng.standard_normal((240, 320)).astype(np.float32) for _ in scales)
    layers = [s * cv2.GaussianBlur(n, (0, 0), s) for n, s in zip(noise, scales, strict=True)]
    total = sum(layers)
    return (0.05 + 0.37 * (total - total.min()) / (total.max() - total.min())).astype(np.float32)


def seen(scene: np.ndarray, index: int, bits: int = 8) -> np.ndarray:
    """What a camera that moves by two pixels a frame records of it."""
    picture = scene[20 : 20 + HEIGHT, 10 + 2 * index : 10 + 2 * index + WIDTH]
    noise = np.random.default_rng(index).standard_normal(picture.shape) * np.sqrt(SENSOR.variance(picture, bits) / 4)
    levels = 4 * (2**bits - 1)
    return (np.rint(np.clip(picture + noise, 0, 1) * levels) / levels).astype(np.float32)


SCENE = texture()
PICTURES = [seen(SCENE, i) for i in range(COUNT)]


def below(picture, other):
    """The upper half of one picture over the lower one of another."""
    half = HEIGHT // 2 + 3
    return np.concatenate([picture[:half], other[half:]])


def noise(seed: int = 7) -> np.ndarray:
    return np.random.default_rng(seed).random((4, HEIGHT, WIDTH), np.float32).mean(axis=0)


def blurred(picture: np.ndarray) -> np.ndarray:
    return cv2.GaussianBlur(picture, (0, 0), 3.0)


def smeared(picture: np.ndarray) -> np.ndarray:
    return cv2.blur(picture, (15, 1))


def far_noisier(picture: np.ndarray) -> np.ndarray:
    return np.clip(picture + 0.1 * np.random.default_rng(3).standard_normal(picture.shape), 0, 1).astype(np.float32)


BY_ITSELF = {
    "black": (lambda p: np.zeros_like(p), Fault.BLACK),
    "dark noise": (lambda p: 0.002 * noise() ** 4, Fault.BLACK),
    "saturated": (lambda p: np.ones_like(p), Fault.CLIPPED),
    "noise": (lambda p: noise(), Fault.NOISE),
    "interpolated noise": (lambda p: cv2.blur(noise(), (2, 2)), Fault.NOISE),
}
AGAINST_OTHERS = {
    "half black": (lambda p: below(p, 0 * p), Fault.PARTLY_BLACK),
    "half saturated": (lambda p: below(p, 0 * p + 1), Fault.PARTLY_CLIPPED),
    "half grey": (lambda p: below(p, 0 * p + 0.5), Fault.CHANGED),
    "half noise": (lambda p: below(p, noise()), Fault.CHANGED),
    "half of another": (lambda p: below(p, seen(SCENE, 40)), Fault.TORN),
    "last row repeated": (lambda p: below(p, np.broadcast_to(p[HEIGHT // 2 + 3], p.shape)), Fault.CHANGED),
    "another place": (lambda p: seen(texture(5), 0), Fault.CHANGED),
    "grey": (lambda p: np.full_like(p, 0.4), Fault.BLANK),
    "blurred": (blurred, Fault.BLURRED),
    "smeared": (smeared, Fault.BLURRED),
    "noisier": (far_noisier, Fault.NOISIER),
    "flash": (lambda p: 2.3 * p, Fault.FLASH),
    "dimmed": (lambda p: 0.3 * p, Fault.FLASH),
}


def judged(pictures, check=None, periods=None) -> dict[int, Fault]:
    """Faults by index, of those too that turn out to be faulty afterwards."""
    check = check or FrameCheck(SENSOR, 8)
    times = np.cumsum(periods) if periods is not None else PERIOD * np.arange(len(pictures))
    faults = {}
    for index, (picture, time) in enumerate(zip(pictures, times, strict=True)):
        verdict = check.judge(np.ascontiguousarray(picture, np.float32), index, float(time))
        faults.update({index: verdict.fault} if verdict.fault else {})
        faults.update([verdict.earlier] if verdict.earlier else [])
    return faults


def spoiled(spoil, *positions: int, count: int = COUNT) -> list[np.ndarray]:
    return [spoil(picture) if i in positions else picture for i, picture in enumerate(PICTURES[:count])]


def test_good_pictures_are_fit():
    assert judged(PICTURES) == {}


@pytest.mark.parametrize("kind", BY_ITSELF)
@pytest.mark.parametrize("position", [0, 5, COUNT - 1])
def test_a_picture_without_light_or_information_is_unfit_wherever_it_is(kind, position):
    spoil, fault = BY_ITSELF[kind]
    assert judged(spoiled(spoil, position)) == {position: fault}


@pytest.mark.parametrize("kind", BY_ITSELF)
def test_it_is_so_however_many_there_are(kind):
    spoil, fault = BY_ITSELF[kind]
    pictures = [seen(SCENE, 0)] + [spoil(PICTURES[0])] * 20
    if fault is Fault.NOISE:
        pictures[1:] = [noise(seed) for seed in range(20)]
    assert judged(pictures[1:]) == dict.fromkeys(range(20), fault)
    assert judged(pictures) == dict.fromkeys(range(1, 21), fault)


@pytest.mark.parametrize("kind", AGAINST_OTHERS)
@pytest.mark.parametrize("position", [2, 5, COUNT - 1])
def test_a_picture_unlike_its_neighbours_is_unfit(kind, position):
    spoil, fault = AGAINST_OTHERS[kind]
    assert judged(spoiled(spoil, position)) == {position: fault}


@pytest.mark.parametrize(
    "kind", sorted(set(AGAINST_OTHERS) - {"last row repeated"})
)  # which needs to know what is usual
def test_if_it_is_the_first_the_next_ones_tell(kind):
    """Where two differ, a third one may have to come; the map can spare the second."""
    faults = judged(spoiled(AGAINST_OTHERS[kind][0], 0))
    assert 0 in faults and set(faults) <= {0, 1}


@pytest.mark.parametrize("kind", AGAINST_OTHERS)
def test_two_in_a_row_are_both_unfit(kind):
    assert set(judged(spoiled(AGAINST_OTHERS[kind][0], 4, 5))) == {4, 5}


LASTING = {
    "dimmed": (lambda p: 0.3 * p, 3),
    "half black": (lambda p: below(p, 0 * p), 10),
    "blurred": (blurred, 10),
    "noisier": (far_noisier, 10),
}


@pytest.mark.parametrize("kind", LASTING)
def test_what_lasts_is_taken_as_it_is(kind):
    spoil, patience = LASTING[kind]
    pictures = PICTURES[:4] + [spoil(seen(SCENE, i)) for i in range(4, 22)]
    faults = judged(pictures)
    assert set(faults) == set(range(4, 4 + len(faults))) and 3 <= len(faults) <= patience


def bare_wall(level: float, shade: float = 0.02, bits: int = 8) -> list[np.ndarray]:
    """A wall without texture whose brightness falls a little from left to right."""
    wall = np.broadcast_to(np.linspace(level, level * (1 - shade), 320, dtype=np.float32), (240, 320))
    return [seen(wall, i, bits) for i in range(COUNT)]


LEGITIMATE = {
    "night": [seen(0.03 * SCENE, i, 12) for i in range(COUNT)],
    "night, 8 bits": [seen(0.05 * SCENE, i) for i in range(COUNT)],
    "lamps in the dark": [seen(np.where(SCENE > 0.32, SCENE, 0), i) for i in range(COUNT)],
    "bare wall": bare_wall(0.5),
    "bare wall, exactly even": bare_wall(0.5, 0.0),
    "bare white wall, nearly saturated": bare_wall(0.985),
    "bare dark wall": bare_wall(0.02, 0.1),
    "much is clipped": [np.minimum(4.0 * p, 1) for p in PICTURES],
    "everything blurred": [blurred(p) for p in PICTURES],
    "gravel": [seen(np.clip(0.4 + 0.15 * texture_of_pixels, 0, 1), i)
               for texture_of_pixels in [np.random.default_rng(2).standard_normal((240, 320)).astype(np.float32)]
               for i in range(1, COUNT)],
    "without noise": [np.float32(SCENE[20:140, 2 * i : 160 + 2 * i]) for i in range(COUNT)],
    "constant": [np.full((HEIGHT, WIDTH), 100 / 255, np.float32)] * COUNT,
    "getting brighter": [np.float32(1.12**i * 0.4 * p) for i, p in enumerate(PICTURES)],
}  # fmt: skip


@pytest.mark.parametrize("kind", sorted(set(LEGITIMATE) - {"gravel"}))
def test_legitimate_pictures_are_fit(kind):
    bits = 12 if kind == "night" else 8
    assert judged(LEGITIMATE[kind], FrameCheck(SENSOR, bits)) == {}


def test_what_looks_like_noise_but_comes_again_is_none():
    """Gravel differs from noise in being there in the next picture too; the very first one cannot tell."""
    assert set(judged(LEGITIMATE["gravel"])) <= {0}


def test_panning_from_texture_to_a_bare_wall_is_fit():
    scene = SCENE.copy()
    scene[:, 150:] = 0.4
    views = [seen(np.roll(scene, -8 * i, axis=1), 0) for i in range(14)]
    assert judged(views) == {}


def test_a_change_of_the_exposure_time_explains_brightness():
    check = FrameCheck(SENSOR, 8)
    for i, picture in enumerate(PICTURES):
        exposure = 0.01 if i < 5 else 0.003
        verdict = check.judge(np.float32(picture * (exposure / 0.01)), i, PERIOD * i, exposure)
        assert verdict.fault is None


def test_after_a_gap_in_time_a_picture_may_show_anything():
    pictures = [*PICTURES[:5], *(seen(0.25 * texture(5), i) for i in range(4))]
    assert judged(pictures, periods=[PERIOD] * 5 + [3.0] + [PERIOD] * 3) == {}
    assert 5 in judged(pictures)


def test_times_need_not_be_known():
    assert judged(spoiled(blurred, 5), periods=[np.nan] * COUNT) == {5: Fault.BLURRED}


def test_what_the_lens_does_not_show_does_not_count():
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    valid = np.hypot(x - 80, y - 60) < 55
    masked = [np.where(valid, picture, 0) for picture in PICTURES]
    check = FrameCheck(SENSOR, 8, valid)
    assert judged(masked, check) == {}
    for kind, (spoil, fault) in BY_ITSELF.items():
        pictures = [np.where(valid, spoil(p), 0) if i == 5 else p for i, p in enumerate(masked)]
        assert judged(pictures, FrameCheck(SENSOR, 8, valid)) == {5: fault}, kind


@pytest.mark.parametrize("shape", [(48, 64), (33, 61), (600, 800)])
def test_any_size_will_do(shape):
    rng = np.random.default_rng(0)
    picture = cv2.resize(rng.random((6, 8), np.float32), shape[::-1], interpolation=cv2.INTER_CUBIC).clip(0.1, 0.9)
    check = FrameCheck(SENSOR, 8)
    assert check.judge(picture, 0).fault is None
    assert check.judge(np.zeros_like(picture), 1).fault is Fault.BLACK
    assert check.judge(np.ones_like(picture), 2).fault is Fault.CLIPPED


def test_the_figures_are_what_they_say():
    look = FrameLooker(SENSOR, 8)(noise())
    assert look.structure == pytest.approx(1.0, abs=0.3) and abs(look.correlation) < 0.05
    assert look.noise == pytest.approx(noise().std(), rel=0.05)
    assert look.variance == pytest.approx(noise().var(), rel=0.05)
    look = FrameLooker(SENSOR, 8)(PICTURES[0])
    assert look.structure > 3 and look.correlation > 0.7 and look.mean == pytest.approx(PICTURES[0].mean(), abs=0.01)
    sharp, soft = (FrameLooker(SENSOR, 8)(p).sharpness for p in (PICTURES[0], blurred(PICTURES[0])))
    assert soft < 0.4 * sharp
    np.testing.assert_allclose(cell_means(np.arange(24, dtype=np.float32).reshape(4, 6), 2)[0, 0], 3.5)


def test_the_texts_are_short_and_each_its_own():
    texts = [fault.text for fault in Fault]
    assert len(set(texts)) == len(texts) and max(map(len, texts)) < 70
