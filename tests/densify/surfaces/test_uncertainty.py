"""How uncertain depth is said to be, against plain NumPy: a piece's evidence counts once, however large it is."""

from __future__ import annotations

import numpy as np
import pytest

from polarmap.densify.surfaces.uncertainty import connected_pieces, surface_sigma, undecided_sigma

CELL = 4
ROWS, COLUMNS = 12, 20
SHAPE = (CELL * ROWS, CELL * COLUMNS)
SURE = np.float32(200.0)  # belief against the other label, as a large piece gathers it
APART = float(np.log(1.3))  # of log depth, of the planes below


def planes(*depths: float, shape=SHAPE) -> np.ndarray:
    """Inverse depth of planes parallel to the image, N×H×W."""
    return np.array([np.full(shape, 1.0 / z, np.float32) for z in depths])


def sigma_of(costs, beliefs, surfaces, cell: int = CELL) -> np.ndarray:
    """Where every pixel has its cell's label."""
    shape = surfaces.shape[1:]
    label = np.kron(beliefs.argmin(axis=2), np.ones((cell, cell)))[: shape[0], : shape[1]].astype(np.int16)
    middles = np.ascontiguousarray(surfaces[:, cell // 2 :: cell, cell // 2 :: cell].transpose(1, 2, 0))
    return undecided_sigma(np.float32(costs), np.float32(beliefs), middles, label, cell)


def sure_of(label: np.ndarray, count: int = 2) -> np.ndarray:
    return np.where(np.arange(count) == label[..., None], np.float32(0.0), SURE)


ONE = np.zeros((ROWS, COLUMNS), int)


def test_a_large_piece_that_has_hardly_any_evidence_is_uncertain_however_sure_its_cells_are():
    """Each cell's costs differ by a twentieth, which the cells add up to certainty."""
    costs = np.broadcast_to(np.float32([0.0, 0.05]), (ROWS, COLUMNS, 2))
    sigma = sigma_of(costs, sure_of(ONE), planes(2.0, 2.6))
    assert sigma.dtype == np.float32 and sigma.shape == SHAPE
    other = np.exp(-1.5 * 0.05)
    np.testing.assert_allclose(sigma, 0.6 * APART * other / (1.0 + other), rtol=1e-4)
    assert sigma.min() > 0.07


def test_one_that_has_evidence_in_all_cells_is_not():
    costs = np.broadcast_to(np.float32([0.0, 6.0]), (ROWS, COLUMNS, 2))
    sigma = sigma_of(costs, sure_of(ONE), planes(2.0, 2.6))
    np.testing.assert_allclose(sigma, 0.6 * APART * np.exp(-9.0), rtol=1e-2)
    assert sigma.max() < 1e-4


def test_the_more_of_a_piece_has_evidence_the_more_certain_is_all_of_it():
    sigmas = []
    for columns in (0, 5, 10, 20):
        costs = np.zeros((ROWS, COLUMNS, 2), np.float32)
        costs[:, :columns, 1] = 9.0
        sigma = sigma_of(costs, sure_of(ONE), planes(2.0, 2.6))
        assert np.ptp(sigma) < 1e-6
        sigmas.append(sigma[0, 0])
    assert (np.diff(sigmas) < -0.01 * np.array(sigmas[:-1])).all()
    excess = 9.0 * np.array([0, 5, 10, 20]) / COLUMNS
    np.testing.assert_allclose(sigmas, 0.6 * APART / (1.0 + np.exp(1.5 * excess)), rtol=1e-4)


def test_how_large_a_piece_is_does_not_matter():
    label = np.zeros((ROWS, COLUMNS), int)
    label[:, 2:4] = 1
    label[:, 4:] = 0
    costs = np.where(np.arange(2) == label[..., None], 0.0, 0.8)
    sigma = sigma_of(costs, sure_of(label), planes(2.0, 2.6))
    np.testing.assert_allclose(sigma, sigma[0, 0], rtol=1e-5)


def test_pieces_of_one_label_that_do_not_touch_are_judged_apart():
    """The left and the right piece are of one plane, and the left one alone has evidence."""
    label = np.zeros((ROWS, COLUMNS), int)
    label[:, 9:11] = 1
    costs = np.zeros((ROWS, COLUMNS, 2), np.float32)
    costs[:, :9, 1] = 9.0
    costs[:, 9:11, 0] = 9.0
    sigma = sigma_of(costs, sure_of(label), planes(2.0, 2.6))
    assert sigma[:, : 9 * CELL].max() < 1e-4 and sigma[:, 9 * CELL : 11 * CELL].max() < 1e-4
    np.testing.assert_allclose(sigma[:, 11 * CELL :], 0.3 * APART, rtol=1e-4)


def test_pieces_that_touch_at_a_corner_only_are_two():
    label = np.zeros((ROWS, COLUMNS), int)
    label[:6, :10] = label[6:, 10:] = 1
    costs = np.zeros((ROWS, COLUMNS, 2), np.float32)
    costs[:6, :10, 0] = 9.0
    sigma = sigma_of(costs, sure_of(label), planes(2.0, 2.6))
    assert sigma[: 6 * CELL, : 10 * CELL].max() < 1e-4
    np.testing.assert_allclose(sigma[6 * CELL :, 10 * CELL :], 0.3 * APART, rtol=1e-4)


def test_where_cells_themselves_waver_the_piece_does_not_make_them_sure():
    costs = np.broadcast_to(np.float32([0.0, 9.0]), (ROWS, COLUMNS, 2))
    beliefs = sure_of(ONE)
    beliefs[4:6, 5:8, 1] = 8.0  # by which the other one is e times less likely
    sigma = sigma_of(costs, beliefs, planes(2.0, 2.6))
    wavering = np.s_[4 * CELL : 6 * CELL, 5 * CELL : 8 * CELL]
    np.testing.assert_allclose(sigma[wavering], 0.6 * APART * np.exp(-1.0) / (1.0 + np.exp(-1.0)), rtol=1e-4)
    rest = np.ones(SHAPE, bool)
    rest[wavering] = False
    assert sigma[rest].max() < 1e-4


def test_a_surface_far_off_or_without_depth_counts_as_half_a_log_depth():
    costs = np.zeros((ROWS, COLUMNS, 2), np.float32)
    for other in (1e4, -2.0, np.inf):
        np.testing.assert_allclose(sigma_of(costs, sure_of(ONE), planes(2.0, other)), 0.6 * 0.25, rtol=1e-5)


def test_with_one_surface_nothing_is_undecided():
    assert not sigma_of(np.ones((ROWS, COLUMNS, 1)), np.zeros((ROWS, COLUMNS, 1)), planes(2.0)).any()


def pieces_of(label: np.ndarray) -> np.ndarray:
    """Number of each cell's connected piece, by flooding from one cell after the other."""
    numbers, count = np.full(label.shape, -1), 0
    for start in np.ndindex(label.shape):
        if numbers[start] >= 0:
            continue
        waiting = [start]
        while waiting:
            i, j = waiting.pop()
            inside = 0 <= i < label.shape[0] and 0 <= j < label.shape[1]
            if inside and numbers[i, j] < 0 and label[i, j] == label[start]:
                numbers[i, j] = count
                waiting += [(i + 1, j), (i - 1, j), (i, j + 1), (i, j - 1)]
        count += 1
    return numbers


@pytest.mark.parametrize("labels", [1, 2, 3])
@pytest.mark.parametrize("shape", [(1, 1), (1, 9), (9, 1), (17, 23)])
def test_pieces_are_those_of_a_flood(shape, labels):
    best = np.random.default_rng(labels).integers(labels, size=shape).astype(np.int16)
    pieces, of_piece = connected_pieces(best)
    expected = pieces_of(best)
    assert len(of_piece) == expected.max() + 1
    np.testing.assert_array_equal(of_piece[pieces], best)
    pairs = np.unique(np.stack([pieces.ravel(), expected.ravel()]), axis=1)
    assert pairs.shape[1] == len(of_piece)  # one of each for one of the other


@pytest.mark.parametrize("shape", [(24, 36), (23, 33), (2, 3)])
@pytest.mark.parametrize("cell", [1, 4])
def test_it_is_as_numpy_says(shape, cell):
    """Mean of the steps over labels, as likely as beliefs say and as the piece's mean costs say; the larger one."""
    rng = np.random.default_rng(cell)
    rows, columns = (-(-size // cell) for size in shape)
    blocks = np.kron(rng.integers(3, size=(rows // 3 + 1, columns // 3 + 1)), np.ones((3, 3), int))[:rows, :columns]
    beliefs = np.where(np.arange(3) == blocks[..., None], 0.0, rng.uniform(0.5, 40.0, (rows, columns, 3)))
    costs = rng.uniform(0.0, 3.0, (rows, columns, 3))
    middles = rng.uniform(0.3, 0.6, (rows, columns, 3)).astype(np.float32)
    middles[:, ::2, 2] = -1.0
    pick = rng.random((rows * cell, columns * cell)) < 0.1  # at borders of cells a pixel may have another's label
    label = np.where(pick, rng.integers(3, size=pick.shape), np.kron(blocks, np.ones((cell, cell), int)))
    label = label[: shape[0], : shape[1]].astype(np.int16)
    found = undecided_sigma(np.float32(costs), np.float32(beliefs), middles, label, cell)
    pieces = pieces_of(blocks)
    for v, u in np.ndindex(shape):
        i, j = v // cell, u // cell
        mean = costs[pieces == pieces[i, j]].mean(axis=0)
        q, chosen = middles[i, j], middles[i, j, label[v, u]]
        positive = (q > 0) & (chosen > 0)
        step = np.minimum(np.abs(np.log(np.where(positive, q, 1e9) / max(chosen, 1e-9))), 0.5)
        by_cell, by_piece = np.exp(-beliefs[i, j] / 8.0), np.exp(-1.5 * np.maximum(mean - mean[blocks[i, j]], 0.0))
        expected = 0.6 * max(np.average(step, weights=by_cell), np.average(step, weights=by_piece))
        assert found[v, u] == pytest.approx(expected, rel=1e-3, abs=1e-5)


def test_a_plane_is_known_by_all_its_points_and_a_little_worse_beside_them():
    distance = np.tile(np.float32([0.0, 3.0, 30.0, 200.0]), (3, 1))
    sigma = surface_sigma(distance, np.ones(distance.shape, bool), 0.004)
    assert sigma.dtype == np.float32 and sigma.shape == distance.shape
    expected = 0.004 * (0.5 + 3.0 * (1.0 - np.exp([0.0, -1.0, -10.0, -70.0])))
    np.testing.assert_allclose(sigma, np.tile(expected, (3, 1)), rtol=1e-5)


def test_a_free_surface_drifts_away_from_the_points_whatever_their_noise():
    """By 3.2 % of depth for each hundredth of the diagonal, from 1 %."""
    distance = np.tile(np.float32([0.0, 1.0, 10.0, 40.0]), (3, 1))  # a diagonal of 5
    nowhere = np.zeros(distance.shape, bool)
    sigma = surface_sigma(distance, nowhere, 0.004)
    np.testing.assert_allclose(sigma, np.hypot(0.01, 3.2 * distance / 5.0), rtol=1e-5)
    np.testing.assert_array_equal(sigma, surface_sigma(distance, nowhere, 0.001))


def test_each_pixel_has_the_deviation_of_its_kind_of_surface():
    rng = np.random.default_rng(0)
    distance, planar = rng.uniform(0.0, 20.0, (9, 11)).astype(np.float32), rng.random((9, 11)) < 0.5
    sigma = surface_sigma(distance, planar, 0.003)
    for kind in (True, False):
        alike = surface_sigma(distance, np.full(planar.shape, kind), 0.003)
        np.testing.assert_array_equal(sigma[planar == kind], alike[planar == kind])
