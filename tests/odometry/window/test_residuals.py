"""The normal equations of the photometric residuals against finite differences and against dense algebra."""

from __future__ import annotations

import numpy as np
import pytest

from polarmap.geometry.camera import PinholeCamera
from polarmap.geometry.lie import adjoint, se3_exp
from polarmap.geometry.pose import inverse
from polarmap.odometry.pattern import PATTERN
from polarmap.odometry.points import ActivePoints, describe
from polarmap.odometry.window.residuals import CALIBRATION, FRAME, GOOD, NONE, OUTLIER, OUTSIDE, linearize
from polarmap.odometry.window.window import Window

CAMERA = PinholeCamera(160, 120, 150.0, 145.0, 81.0, 58.5)
HUBER, CONSTANT = 1e6, 1e6  # neither robust nor weighted: a plain quadratic
ROBUST, WEIGHING = 9.0, 1.0  # most residuals are linear, and weights far from 1 and from each other


def ramp(slope_u: float, slope_v: float, level: float) -> np.ndarray:
    """An image of constant gradient, on which bilinear interpolation is exact."""
    v, u = np.mgrid[: CAMERA.height, : CAMERA.width].astype(np.float32)
    image = np.empty((*CAMERA.shape, 3), np.float32)
    image[..., 0] = level + slope_u * u + slope_v * v
    image[..., 1], image[..., 2] = slope_u, slope_v
    return image


def three_keyframes(seed: int = 0, points: int = 40, constant: float = CONSTANT) -> Window:
    """A window of three keyframes a little apart, points in the first two, at a state off the first estimate."""
    rng = np.random.default_rng(seed)
    window = Window(CAMERA, 4)
    for index in range(3):
        pose = se3_exp(rng.normal(size=6) * [0.1, 0.1, 0.1, 0.02, 0.02, 0.02])
        image = ramp(*rng.uniform(0.3, 1.0, 2) * rng.choice([-1, 1], 2), 90.0)
        window.add(index, image, pose, rng.normal(size=2) * [0.05, 2.0], exposure=1.0 + 0.1 * index)
    window.prior_H[:] = 0.0
    pixels = np.stack([rng.integers(45, 115, points), rng.integers(42, 78, points)], axis=1)
    host = np.where(np.arange(points) < points // 2, 0, 1).astype(np.int32)
    color, weight = np.empty((points, 8), np.float32), np.empty((points, 8), np.float32)
    for slot in (0, 1):
        own = host == slot
        color[own], weight[own], _ = describe(window.images[slot], pixels[own], constant)
    state = np.full((points, 4), GOOD, np.uint8)
    state[np.arange(points), host] = NONE
    state[:, 3] = NONE
    window.points = ActivePoints(
        host, pixels.astype(np.float32), rng.uniform(0.3, 1.0, points).astype(np.float32), color, weight, state,
        np.zeros(points, np.float32), np.zeros(points, np.int32),
    )  # fmt: skip
    return window


def system(window: Window, huber: float = HUBER, constant: float = CONSTANT):
    """The linearization of a window without outliers."""
    thresholds = np.full(window.capacity, 1e12, np.float32)
    return linearize(window.images, window.points, window.pairs(), thresholds, huber, constant)


def same_view(window: Window, target: int) -> tuple[np.ndarray, np.ndarray]:
    """Points whose residual in the target exists, and their predicted pixels there over the pattern, float64 N×8×2."""
    points = window.points
    chosen = np.flatnonzero(points.state[:, target] == GOOD)
    K = window.matrix
    pixel = points.pixel[chosen].astype(float)[:, None] + PATTERN
    rays = np.concatenate([pixel, np.ones((*pixel.shape[:2], 1))], axis=2) @ np.linalg.inv(K).T
    poses = {k.slot: k.T_camera_world for k in window.keyframes}
    T = np.stack([poses[target] @ inverse(poses[h]) for h in points.host[chosen]])
    p = np.einsum("nij,nkj->nki", T[:, :3, :3], rays)
    p = (p + points.inverse_depth[chosen].astype(float)[:, None, None] * T[:, None, :3, 3]) @ K.T
    return chosen, p[..., :2] / p[..., 2:]


def brightness(window: Window, target: int, chosen: np.ndarray):
    """Gain and offset of the points' hosts to the target, N each (DSO, equation 4)."""
    state = {k.slot: (*k.affine, k.exposure) for k in window.keyframes}
    a, b, t = state[target]
    hosts = np.array([state[h] for h in window.points.host[chosen]])
    gain = t / hosts[:, 2] * np.exp(a - hosts[:, 0])
    return gain[:, None], (b - gain * hosts[:, 1])[:, None]


def fitting(window: Window) -> Window:
    """The window with one residual a point, and the points' colors such that it is zero."""
    points = window.points
    points.state[np.arange(len(points)), np.where(np.arange(len(points)) % 2, 2, 1 - points.host)] = NONE
    for target in range(3):
        chosen, pixel = same_view(window, target)
        level = window.images[target].astype(float)
        value = level[0, 0, 0] + level[0, 0, 1] * pixel[..., 0] + level[0, 0, 2] * pixel[..., 1]
        gain, offset = brightness(window, target, chosen)
        points.color[chosen] = (value - offset) / gain
    return window


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


@pytest.mark.parametrize(("huber", "constant"), [(HUBER, CONSTANT), (ROBUST, CONSTANT), (HUBER, WEIGHING)])
def test_energies_are_those_of_the_definition(huber, constant):
    window = three_keyframes(constant=constant)
    found = system(window, huber, constant)
    for target in range(3):
        chosen, pixel = same_view(window, target)
        start, gx, gy = window.images[target][0, 0].astype(float)
        gain, offset = brightness(window, target, chosen)
        r = np.abs(start + gx * pixel[..., 0] + gy * pixel[..., 1] - gain * window.points.color[chosen] - offset)
        weight = 0.5 * (np.sqrt(constant**2 / (constant**2 + gx**2 + gy**2)) + window.points.weight[chosen])
        rho = np.where(r <= huber, r**2, huber * (2 * r - huber))
        np.testing.assert_allclose(found.energies[chosen, target], (weight**2 * rho).sum(1), rtol=2e-4)
    assert found.energy == pytest.approx(found.energies.sum(dtype=float), rel=1e-6)


@pytest.mark.parametrize(("huber", "constant"), [(HUBER, CONSTANT), (ROBUST, WEIGHING)])
@pytest.mark.parametrize("variable", range(CALIBRATION + 3 * FRAME))
def test_gradient_by_every_variable(variable, huber, constant):
    part = (variable - CALIBRATION) % FRAME
    step = STEPS[variable] if variable < CALIBRATION else (0.5 if part == 7 else 1e-3)
    energies = []
    for sign in (1, -1):
        window = three_keyframes(constant=constant)
        moved(window, variable, sign * step)
        energies.append(system(window, huber, constant).energy)
    expected = (energies[0] - energies[1]) / (2 * step)
    b = system(three_keyframes(constant=constant), huber, constant).b
    scale = np.abs(b[CALIBRATION:]).mean() if variable >= CALIBRATION else np.abs(b[:CALIBRATION]).max()
    np.testing.assert_allclose(2 * b[variable], expected, rtol=0.02, atol=0.01 * scale)


@pytest.mark.parametrize(("huber", "constant"), [(HUBER, CONSTANT), (ROBUST, WEIGHING)])
def test_gradient_by_inverse_depth(huber, constant):
    window = three_keyframes(constant=constant)
    found = system(window, huber, constant)
    step = np.float32(1e-3)
    window.points.inverse_depth = window.points.inverse_depth + step
    above = system(window, huber, constant).energies.sum(axis=1)
    window.points.inverse_depth = window.points.inverse_depth - 2 * step
    below = system(window, huber, constant).energies.sum(axis=1)
    expected = (above - below) / (2 * step)
    scale = np.abs(expected).mean()
    np.testing.assert_allclose(2 * found.depth_gradient, expected, rtol=0.03, atol=0.02 * scale)


@pytest.mark.parametrize("constant", [CONSTANT, WEIGHING])
@pytest.mark.parametrize("variable", range(CALIBRATION + 3 * FRAME))
def test_hessian_is_the_gradients_change_where_residuals_are_zero(variable, constant):
    found = system(fitting(three_keyframes(constant=constant)), constant=constant)
    step = STEPS[variable] if variable < CALIBRATION else (0.5 if (variable - CALIBRATION) % FRAME == 7 else 1e-3)
    change, depth_change = 0.0, 0.0
    for sign in (1, -1):
        window = fitting(three_keyframes(constant=constant))
        moved(window, variable, sign * step)
        above = system(window, constant=constant)
        change = change + sign * above.b / (2 * step)
        depth_change = depth_change + sign * above.depth_gradient / (2 * step)
    scale = np.sqrt(found.H[variable, variable] * np.diag(found.H))
    assert (np.abs(change - found.H[variable]) <= 0.02 * scale).all()
    scale = np.sqrt(found.H[variable, variable] * found.depth_hessian)
    assert (np.abs(depth_change - found.coupling[:, variable]) <= 0.02 * scale).all()


def test_depth_hessian_is_the_gradients_change_where_residuals_are_zero():
    window = fitting(three_keyframes())
    found = system(window)
    window.points.inverse_depth += np.float32(1e-3)
    change = (system(window).depth_gradient - found.depth_gradient) / 1e-3
    np.testing.assert_allclose(change, found.depth_hessian, rtol=0.05, atol=0.01 * found.depth_hessian.mean())


def test_derivatives_stay_those_at_the_first_estimate():
    """On ramps nothing else in them depends on the poses and on the brightness."""
    window = three_keyframes()
    before = system(window)
    for keyframe in window.keyframes[1:]:
        keyframe.step = np.array([0.03, -0.02, 0.04, 0.01, 0.02, -0.02])
        keyframe.affine = keyframe.affine + np.array([0.2, 3.0])
    after = system(window)
    np.testing.assert_allclose(after.H, before.H, rtol=1e-6, atol=1e-6 * np.abs(before.H).max())
    np.testing.assert_allclose(after.coupling, before.coupling, rtol=1e-4, atol=1e-5 * np.abs(before.coupling).max())
    assert np.abs(after.b - before.b).max() > 0.1 * np.abs(before.b).max()


def test_common_motion_and_scale_change_nothing_wherever_the_state_is():
    """The seven directions that images do not determine, which a mixture of linearization points would lose."""
    window = three_keyframes()
    for keyframe in window.keyframes:
        keyframe.step = np.array([0.03, -0.02, 0.04, 0.01, 0.02, -0.02]) * (keyframe.slot + 1)
    found = system(window)
    H = found.H - found.H_schur
    free = np.zeros((len(H), 7))
    for keyframe in window.keyframes:
        at = CALIBRATION + FRAME * keyframe.slot
        free[at : at + 6, :6] = adjoint(keyframe.T_first)
        free[at : at + 3, 6] = keyframe.T_first[:3, 3]
    scale = np.sqrt(np.maximum(np.diag(H), 1e-12))
    assert np.abs(H @ free / scale[:, None]).max() < 1e-4 * np.abs(scale[:, None] * free).max()


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
    threads = numba.get_num_threads()
    try:
        numba.set_num_threads(numba.config.NUMBA_NUM_THREADS)
        several = system(window)
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
