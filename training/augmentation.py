"""From a rendered sample to what a camera might have shown: another crop, light, exposure, noise, blur, gamma.

Polarization is often withheld, so that the network serves grey pictures too, and sometimes replaced by that of the
paper's model, in which each pixel is purely diffuse or purely specular.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from polarmap.data.codes import Reflection
from polarmap.geometry.camera import PinholeCamera
from polarmap.prior.polarization_input import network_input
from polarmap.synth.dielectric import fresnel_reflectances, fresnel_transmittances
from training.views import HEIGHT, WIDTH

_WITHHELD = 0.4
_PURE = 0.12


@dataclass(frozen=True)
class Example:
    """Input 6×H×W and truth at H/2×W/2: inverse depth, normal 3×h×w, specular, surface."""

    input: np.ndarray
    inverse_depth: np.ndarray
    normal: np.ndarray
    specular: np.ndarray
    surface: np.ndarray


@dataclass(frozen=True)
class _View:
    """A crop at the network's size, normalized coordinates H×W×2."""

    stokes: np.ndarray
    depth: np.ndarray
    normal: np.ndarray
    specular: np.ndarray
    normalized: np.ndarray


def example(sample: np.ndarray, size: tuple[int, int], rng: np.random.Generator) -> Example:
    """One training example of (height, width) `size` from a record of the pool."""
    view = _flipped(_crop(sample, size, rng), rng)
    polarized = rng.random() >= _WITHHELD
    stokes = view.stokes
    if polarized and rng.random() < _PURE:
        stokes = _purely_polarized(view, rng)
    stokes = _relit(stokes, view, rng)
    intensity, s1, s2 = _captured(_blurred(stokes, rng), rng)
    if not polarized:
        s1, s2 = (None, None) if rng.random() < 0.7 else _nothing_but_noise(intensity, rng)
    intensity, s1, s2 = _toned(intensity, s1, s2, rng)
    return Example(network_input(intensity, s1, s2, view.normalized), *_truth(view))


def _truth(view: _View) -> tuple[np.ndarray, ...]:
    """Every second pixel of the view's geometry."""
    depth = view.depth[::2, ::2]
    surface = np.isfinite(depth)
    return (
        (1.0 / depth).astype(np.float32),
        np.ascontiguousarray(view.normal[:, ::2, ::2]),
        view.specular[::2, ::2].astype(np.float32),
        surface.astype(np.float32),
    )


def _crop(sample: np.ndarray, size: tuple[int, int], rng: np.random.Generator) -> _View:
    """Part of a sample, resized; its sides a little out of proportion now and then."""
    height, width = size
    share = rng.uniform(0.55, 1.0) if rng.random() < 0.5 else 1.0
    h, w = share * HEIGHT, share * WIDTH
    if rng.random() < 0.3:
        h, w = (h * rng.uniform(0.75, 1.0), w) if rng.random() < 0.5 else (h, w * rng.uniform(0.75, 1.0))
    h, w = round(float(h)), round(float(w))
    top, left = int(rng.integers(HEIGHT - h + 1)), int(rng.integers(WIDTH - w + 1))
    part = np.s_[..., top : top + h, left : left + w]
    stokes = np.stack([_resized(s, width, height) for s in sample["stokes"][part].astype(np.float32)])
    # The output's pixel (i, j) covers the input's pixels 2i, 2i + 1: truth is read at their common corner.
    v = top + np.clip(((np.arange(height) + 1.0 - np.arange(height) % 2) * h / height).astype(int), 0, h - 1)
    u = left + np.clip(((np.arange(width) + 1.0 - np.arange(width) % 2) * w / width).astype(int), 0, w - 1)
    grid = np.ix_(v, u)
    fx, fy, cx, cy = map(float, sample["camera"])
    camera = PinholeCamera(w, h, fx, fy, cx - left, cy - top)
    return _View(
        stokes,
        sample["depth"][grid].astype(np.float32),
        np.stack([n[grid] for n in sample["normal"]]).astype(np.float32) / 127.0,
        sample["reflection"][grid] == Reflection.SPECULAR,
        camera.resized(size).normalized(),
    )


def _resized(image: np.ndarray, width: int, height: int) -> np.ndarray:
    shrinking = width <= image.shape[1]
    return cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA if shrinking else cv2.INTER_LINEAR)


def _flipped(view: _View, rng: np.random.Generator) -> _View:
    """Mirrored left to right, half the time: then S2, n_x and x change their sign. Up stays up.

    Truth stays on even pixels by one more column's shift, which its nearest-pixel reading has already anyway.
    """
    if rng.random() < 0.5:
        return view
    sign = np.array([1.0, 1.0, -1.0], np.float32)[:, None, None]
    mirrored = np.array([-1.0, 1.0, 1.0], np.float32)[:, None, None]
    return _View(
        np.ascontiguousarray(view.stokes[..., ::-1]) * sign,
        view.depth[:, ::-1],
        view.normal[..., ::-1] * mirrored,
        view.specular[:, ::-1],
        np.ascontiguousarray(view.normalized[:, ::-1]) * np.array([-1.0, 1.0], np.float32),
    )


def _purely_polarized(view: _View, rng: np.random.Generator) -> np.ndarray:
    """Stokes vectors by the paper's equations (5) and (6), the kind chosen by smooth patches or as rendered."""
    n, (x, y) = view.normal, view.normalized.transpose(2, 0, 1)
    cosine = np.clip(-(n[0] * x + n[1] * y + n[2]) / np.sqrt(1.0 + x * x + y * y), 0.02, 1.0)
    eta = rng.uniform(1.4, 1.6)
    specular = view.specular if rng.random() < 0.4 else _field(x.shape, rng) > rng.uniform(-0.8, 1.5)
    t_s, t_p = fresnel_transmittances(cosine, eta)
    r_s, r_p = fresnel_reflectances(cosine, eta)
    degree = np.where(specular, (r_p - r_s) / (r_p + r_s), (t_p - t_s) / (t_p + t_s))  # negative: across
    dx, dy = n[0] - n[2] * x, n[1] - n[2] * y
    along = (dx * x + dy * y) / (1.0 + x * x + y * y)  # mirrored light: across the gradient of range, not across d
    dx, dy = np.where(specular, dx - x * along, dx), np.where(specular, dy - y * along, dy)
    squared = np.maximum(dx * dx + dy * dy, 1e-9)
    s0 = view.stokes[0]
    polarized = np.where(np.isfinite(view.depth), s0 * degree, 0.0)
    return np.stack([s0, polarized * (dx * dx - dy * dy) / squared, polarized * 2 * dx * dy / squared]).astype(
        np.float32
    )


def _field(shape: tuple[int, int], rng: np.random.Generator, cells: int = 5) -> np.ndarray:
    """A smooth random field of unit variance."""
    coarse = rng.normal(0, 1, (int(rng.integers(2, cells)), int(rng.integers(2, cells)))).astype(np.float32)
    return cv2.resize(coarse, shape[::-1], interpolation=cv2.INTER_CUBIC)


def _relit(stokes: np.ndarray, view: _View, rng: np.random.Generator) -> np.ndarray:
    """Changed by what the renderer lacks: uneven light, darkened creases, vignetting, surfaces that depolarize."""
    shape = stokes.shape[1:]
    gain = np.ones(shape, np.float32)
    if rng.random() < 0.5:
        gain *= np.exp(rng.uniform(0.05, 0.5) * _field(shape, rng))
    if rng.random() < 0.6:
        gain *= np.exp(-rng.uniform(0.0, 6.0) * _hollowness(view.depth, rng))
    if rng.random() < 0.3:
        gain *= 1.0 - rng.uniform(0.1, 0.6) * np.minimum(np.square(view.normalized).sum(axis=-1), 1.0)
    weak = rng.uniform(0.4, 1.2) * (np.clip(0.7 + 0.5 * _field(shape, rng), 0.1, 1.0) if rng.random() < 0.3 else 1.0)
    return stokes * gain * np.stack([np.ones(shape), weak * np.ones(shape), weak * np.ones(shape)]).astype(np.float32)


def _hollowness(depth: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """How far a pixel lies behind its surroundings: unsharp masking of the depth buffer (Luft et al. 2006)."""
    q = np.ascontiguousarray(1.0 / depth)
    sigma = rng.uniform(0.01, 0.06) * depth.shape[1]
    around = cv2.GaussianBlur(q, (0, 0), sigma)
    return np.clip((around - q) / (around + 1e-6), 0.0, 0.4)


def _blurred(stokes: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    if rng.random() < 0.55:
        return stokes
    width = stokes.shape[2] / WIDTH
    if rng.random() < 0.7:
        sigma = rng.uniform(0.3, 1.6) * width
        return np.stack([cv2.GaussianBlur(s, (0, 0), sigma) for s in stokes])
    length = max(round(rng.uniform(2, 8) * width), 1)  # of motion
    kernel = np.zeros((2 * length + 1, 2 * length + 1), np.float32)
    angle = rng.uniform(0, np.pi)
    end = (length * np.cos(angle), length * np.sin(angle))
    cv2.line(kernel, tuple(round(length - e) for e in end), tuple(round(length + e) for e in end), 1.0)
    return np.stack([cv2.filter2D(s, -1, kernel / kernel.sum()) for s in stokes])


def _captured(stokes: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(I, S1, S2) with I = S0/2, 1 at full scale, as exposure, noise and clipping leave them."""
    white = np.percentile(stokes[0, ::4, ::4], 98)
    exposure = np.exp(rng.uniform(np.log(0.25), np.log(1.5))) / max(float(white), 1e-6)
    s = stokes * np.float32(exposure)
    electrons, read = np.exp(rng.uniform(np.log(2e3), np.log(2e6))), rng.uniform(0.0, 0.003)
    sigma = np.sqrt(np.maximum(s[0], 0.0) / electrons + read**2).astype(np.float32)
    noise = rng.standard_normal(s.shape, dtype=np.float32) * sigma
    noise[1:] *= np.float32(np.sqrt(2.0))
    s = s + noise
    clipped = np.hypot(s[1], s[2]) + s[0] > 1.0
    clipped |= s[0] < 4.0 * read
    s[1:][:, clipped] = 0.0
    return np.clip(s[0], 0.0, 1.0), s[1] * np.float32(2.0), s[2] * np.float32(2.0)


def _nothing_but_noise(intensity: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    sigma = rng.uniform(0.0, 0.02)
    noise = rng.standard_normal((2, *intensity.shape), dtype=np.float32) * np.float32(sigma) * 2.0 * intensity
    return noise[0], noise[1]


def _toned(intensity: np.ndarray, s1, s2, rng: np.random.Generator) -> tuple:
    """Another gamma and contrast of the brightness, degrees of polarization kept."""
    gamma = float(np.exp(rng.normal(0.0, 0.3)))
    toned = np.power(intensity, np.float32(gamma))
    if rng.random() < 0.25:
        lift = np.float32(rng.uniform(0.0, 0.15))
        toned = lift + (1.0 - lift) * toned
    if s1 is None:
        return toned, None, None
    factor = toned / np.maximum(intensity, 1e-6)
    return toned, s1 * factor, s2 * factor
