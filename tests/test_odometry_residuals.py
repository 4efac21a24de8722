"""The normal equations of the photometric residuals against finite differences and against dense algebra."""

from __future__ import annotations

import numpy as np
import pytest

from polarmap.geometry.camera import PinholeCamera
from polarmap.geometry.lie import se3_exp
from polarmap.odometry.points import ActivePoints, describe
from polarmap.odometry.residuals import CALIBRATION, FRAME, GOOD, NONE, OUTLIER, OUTSIDE, linearize
from polarmap.odometry.window import Window

CAMERA = PinholeCamera(160, 120, 150.0, 145.0, 81.0, 58.5)
HUBER, CONSTANT = 1e6, 1e6  # neither robust nor weighted: a plain quadratic


def ramp(slope_u: float, slope_v: float, level: float) -> np.ndarray:
    """An image of constant gradient, on which bilinear interpolation is exact."""
    v, u = np.mgrid[: CAMERA.height, : CAMERA.width].astype(np.float32)
    image = np.empty((*CAMERA.shape, 3), np.float32)
    image[..., 0] = level + slope_u * u + slope_v * v
    image[..., 1], image[..., 2] = slope_u, slope_v
    return image


def three_keyframes(seed: int = 0, points: int = 40) -> Window:
    """A window of three keyframes a little apart, points in the first two, at a state off the first estimate."""
    rng = np.random.default_rng(seed)
    window = Window(CAMERA, 4)
    for index in range(3):
        pose = se3_exp(rng.normal(size=6) * [0.1, 0.1, 0.1, 0.02, 0.02, 0.02])
        image = ramp(*rng.uniform(0.3, 1.0, 2) * rng.choice([-1, 1], 2), 90.0)
        window.add(index, image, pose, rng.normal(size=2) * [0.05, 2.0], exposure=1.0 + 0.1 * index)
    window.prior_H[:] = 0.0
    pixels = np.stack([rng.integers(30, 130, points), rng.integers(30, 90, points)], axis=1)
    host = np.where(np.arange(points) < points // 2, 0, 1).astype(np.int32)
    color, weight = np.empty((points, 8), np.float32), np.empty((points, 8), np.float32)
    for slot in (0, 1):
        own = host == slot
        color[own], weight[own], _ = describe(window.images[slot], pixels[own], CONSTANT)
    state = np.full((points, 4), GOOD, np.uint8)
    state[np.arange(points), host] = NONE
    state[:, 3] = NONE
    window.points = ActivePoints(
        host, pixels.astype(np.float32), rng.uniform(0.3, 1.0, points).astype(np.float32), color, weight, state,
        np.zeros(points, np.float32), np.zeros(points, np.int32),
    )  # fmt: skip
    return window


def system(window: Window):
    """The linearization of a window without outliers."""
    thresholds = np.full(window.capacity, 1e12, np.float32)
    return linearize(window.images, window.points, window.pairs(), thresholds, HUBER, CONSTANT)


def moved(window: Window, variable: int, step: float):
    """Change one variable of the window; also the first estimate, at which derivatives are taken."""
    if variable < CALIBRATION:
        window.calibration[variable] += step
        return
    keyframe = window.keyframes[(variable - CALIBRATION) // FRAME]
    part = (variable - CALIBRATION) % FRAME
    if part < 6:
        xi = np.zeros(6)
        xi[part] = step
        keyframe.T_first = se3_exp(xi) @ keyframe.T_first
    else:
        keyframe.affine[part - 6] += step
        keyframe.affine_first = keyframe.affine.copy()


STEPS = {0: 0.3, 1: 0.3, 2: 0.1, 3: 0.1}


@pytest.mark.parametrize("variable", range(CALIBRATION + 3 * FRAME))
def test_gradient_by_every_variable(variable):
    part = (variable - CALIBRATION) % FRAME
    step = STEPS[variable] if variable < CALIBRATION else (0.5 if part == 7 else 1e-3)
    energies = []
    for sign in (1, -1):
        window = three_keyframes()
        moved(window, variable, sign * step)
        energies.append(system(window).energy)
    expected = (energies[0] - energies[1]) / (2 * step)
    window = three_keyframes()
    b = system(window).b
    scale = np.abs(b[CALIBRATION:]).mean() if variable >= CALIBRATION else np.abs(b[:CALIBRATION]).max()
    np.testing.assert_allclose(2 * b[variable], expected, rtol=0.02, atol=0.01 * scale)


def test_gradient_by_inverse_depth():
    window = three_keyframes()
    found = system(window)
    step = np.float32(1e-3)
    window.points.inverse_depth = window.points.inverse_depth + step
    above = system(window).energies.sum(axis=1)
    window.points.inverse_depth = window.points.inverse_depth - 2 * step
    below = system(window).energies.sum(axis=1)
    expected = (above - below) / (2 * step)
    scale = np.abs(expected).mean()
    np.testing.assert_allclose(2 * found.depth_gradient, expected, rtol=0.03, atol=0.02 * scale)


def test_hessian_is_the_gradients_change():
    """On ramps residuals are close to linear, so H is the change of b."""
    window = three_keyframes()
    H = system(window).H
    for variable in (4, 9, 10, 11, 12, 17, 21, 27):
        step = 1e-3 if (variable - CALIBRATION) % FRAME != 7 else 0.5
        gradients = []
        for sign in (1, -1):
            window = three_keyframes()
            moved(window, variable, sign * step)
            gradients.append(system(window).b)
        change = (gradients[0] - gradients[1]) / (2 * step)
        relevant = np.arange(CALIBRATION, CALIBRATION + 3 * FRAME)
        scale = np.sqrt(H[variable, variable] * np.diag(H)[relevant])
        assert np.abs(change[relevant] - H[variable, relevant]).max() / scale.max() < 0.15
        np.testing.assert_allclose(change[variable], H[variable, variable], rtol=0.1)


def test_eliminated_depths_equal_a_dense_solve():
    window = three_keyframes()
    found = system(window)
    free = np.arange(CALIBRATION + FRAME, CALIBRATION + 3 * FRAME)  # the first keyframe and the calibration held
    count = len(window.points)
    dense = np.zeros((len(free) + count, len(free) + count))
    dense[: len(free), : len(free)] = found.H[np.ix_(free, free)]
    dense[len(free) :, : len(free)] = found.coupling[:, free]
    dense[: len(free), len(free) :] = found.coupling[:, free].T
    dense[len(free) :, len(free) :] = np.diag(found.depth_hessian)
    dense += 1e-3 * np.diag(np.r_[np.diag(dense)[: len(free)], np.zeros(count)])
    gradient = np.concatenate([found.b[free], found.depth_gradient])
    whole = np.linalg.solve(dense, -gradient)
    reduced = dense[: len(free), : len(free)] - found.H_schur[np.ix_(free, free)]
    step = np.linalg.solve(reduced, -(found.b - found.b_schur)[free])
    np.testing.assert_allclose(step, whole[: len(free)], rtol=1e-3, atol=1e-6)
    depth = -(found.depth_gradient + found.coupling[:, free] @ step) / found.depth_hessian
    np.testing.assert_allclose(depth, whole[len(free) :], rtol=1e-2, atol=1e-4)


def test_sums_do_not_depend_on_the_number_of_threads():
    import numba

    window = three_keyframes(points=64)
    several = system(window)
    threads = numba.get_num_threads()
    try:
        numba.set_num_threads(1)
        single = system(window)
    finally:
        numba.set_num_threads(threads)
    np.testing.assert_array_equal(single.H, several.H)
    np.testing.assert_array_equal(single.H_schur, several.H_schur)


def test_points_that_leave_the_image_or_do_not_fit_do_not_count():
    window = three_keyframes()
    window.points.pixel[0] = (3.0, 3.0)
    window.points.color[1] += 200.0
    thresholds = np.full(window.capacity, 8 * 100.0**2, np.float32)
    found = linearize(window.images, window.points, window.pairs(), thresholds, HUBER, CONSTANT)
    assert OUTSIDE in found.state[0]
    assert set(found.state[1, [1, 2]]) == {OUTLIER}
    assert found.depth_hessian[1] == 0.0
    assert not found.coupling[1].any()
