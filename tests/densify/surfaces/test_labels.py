"""Labels of cells against brute force, and what they do where there is no evidence."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from polarmap.densify.surfaces.labels import _merged, _merged_across, _refined, best_labels, label_cells

ROUNDS = 40  # that the damped messages of a tree come to rest


def random_problem(rows: int, columns: int, labels: int, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Costs, and costs of a change to the right and down."""
    rng = np.random.default_rng(seed)
    costs = rng.uniform(0.0, 4.0, (rows, columns, labels)).astype(np.float32)
    right, down = rng.uniform(0.0, 2.0, (2, rows, columns)).astype(np.float32)
    return costs, right, down


def energies(costs, right, down, labellings) -> np.ndarray:
    """E of labellings N×rows×columns."""
    rows, columns, _ = costs.shape
    own = costs[np.arange(rows)[:, None], np.arange(columns), labellings].sum(axis=(1, 2))
    across = (right[:, :-1] * (np.diff(labellings, axis=2) != 0)).sum(axis=(1, 2))
    return own + across + (down[:-1] * (np.diff(labellings, axis=1) != 0)).sum(axis=(1, 2))


def all_labellings(rows: int, columns: int, labels: int) -> np.ndarray:
    return np.indices((labels,) * (rows * columns), np.int8).reshape(rows * columns, -1).T.reshape(-1, rows, columns)


def best_costs(costs, right, down) -> np.ndarray:
    """Cost of the best labelling in which a cell has a label, less that of the best of all, by trying every one."""
    labellings = all_labellings(*costs.shape)
    energy = energies(costs, right, down, labellings)
    best = np.empty(costs.shape)
    for i, j, k in itertools.product(*map(range, costs.shape)):
        best[i, j, k] = energy[labellings[:, i, j] == k].min()
    return best - energy.min()


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("shape", [(1, 8), (8, 1)])
def test_chains_are_solved_exactly(shape, seed):
    problem = random_problem(*shape, 3, seed)
    np.testing.assert_allclose(label_cells(*problem, ROUNDS), best_costs(*problem), atol=1e-4)


@pytest.mark.parametrize("seed", range(3))
def test_trees_are_solved_exactly(seed):
    """Columns that only the middle row joins."""
    costs, right, down = random_problem(3, 3, 3, seed)
    right[[0, 2]] = 0.0
    beliefs = label_cells(costs, right, down, ROUNDS)
    np.testing.assert_allclose(beliefs, best_costs(costs, right, down), atol=1e-4)
    turned = label_cells(costs.transpose(1, 0, 2), down.T, right.T, ROUNDS)
    np.testing.assert_allclose(turned.transpose(1, 0, 2), beliefs, atol=1e-4)


def test_grids_are_solved_almost_always():
    """Loops make belief propagation inexact, but not by much."""
    labellings, exact = all_labellings(3, 4, 3), 0
    for seed in range(6):
        problem = random_problem(3, 4, 3, seed)
        least = energies(*problem, labellings).min()
        found = energies(*problem, label_cells(*problem, ROUNDS).argmin(axis=2)[None])[0]
        assert least - 1e-4 < found < 1.03 * least
        exact += found < least + 1e-4
    assert exact >= 5


def test_without_costs_of_a_change_each_cell_decides_alone():
    costs, right, down = random_problem(30, 26, 4, 0)
    beliefs = label_cells(costs, 0.0 * right, 0.0 * down)
    np.testing.assert_allclose(beliefs, costs - costs.min(axis=2, keepdims=True), atol=1e-5)


def test_a_constant_per_cell_changes_nothing():
    costs, right, down = random_problem(25, 31, 3, 0)
    offset = np.random.default_rng(1).uniform(0.0, 5.0, (25, 31, 1)).astype(np.float32)
    np.testing.assert_allclose(label_cells(costs + offset, right, down), label_cells(costs, right, down), atol=2e-4)


def uniform(rows: int, columns: int, weight: float) -> tuple[np.ndarray, np.ndarray]:
    return tuple(np.full((2, rows, columns), weight, np.float32))


@pytest.mark.parametrize("shape", [(48, 64), (49, 63), (25, 90)])
def test_a_large_area_without_evidence_is_labelled_by_its_surroundings(shape):
    costs = np.zeros((*shape, 3), np.float32)
    frame = np.ones(shape, bool)
    frame[1:-1, 1:-1] = False
    costs[frame] = 3.0, 3.0, 0.0
    beliefs = label_cells(costs, *uniform(*shape, 1.0), rounds=4)
    assert (beliefs.argmin(axis=2) == 2).all()


LOST = pytest.mark.xfail(strict=True, reason="edges within merged cells are lost on the coarser grids")


@pytest.mark.parametrize("edge", [15, 17, 31, pytest.param(16, marks=LOST), pytest.param(32, marks=LOST)])
def test_labels_change_where_it_is_cheap(edge):
    """Evidence at the left and at the right border, and an edge of the image between."""
    rows, columns = 30, 50
    costs = np.zeros((rows, columns, 3), np.float32)
    costs[:, 0], costs[:, -1] = (2.0, 0.0, 2.0), (2.0, 2.0, 0.0)
    right, down = uniform(rows, columns, 1.0)
    right[:, edge] = 0.05
    labels = label_cells(costs, right, down, rounds=4).argmin(axis=2)
    np.testing.assert_array_equal(labels, np.broadcast_to(np.where(np.arange(columns) <= edge, 1, 2), labels.shape))


def test_a_single_dissenter_is_overruled_and_a_clear_one_is_not():
    costs = np.zeros((40, 40, 2), np.float32)
    costs[..., 1] = 0.5
    costs[20, 20], costs[10, 10] = (3.0, 0.0), (6.0, 0.0)  # against four changes of 1 and its own half
    labels = label_cells(costs, *uniform(40, 40, 1.0), rounds=8).argmin(axis=2)
    assert labels[20, 20] == 0 and labels[10, 10] == 1 and labels.sum() == 1


@pytest.mark.parametrize("shape", [(1, 1), (1, 60), (60, 1), (2, 3), (25, 31), (24, 24), (47, 51)])
def test_any_size_will_do(shape):
    """One cell's evidence decides all."""
    costs = np.zeros((*shape, 2), np.float32)
    costs[-1, -1] = 5.0, 0.0
    beliefs = label_cells(costs, *uniform(*shape, 6.0))
    assert beliefs.shape == (*shape, 2) and beliefs.dtype == np.float32
    assert (beliefs[..., 1] == 0.0).all() and (beliefs[..., 0] > 0.0).all()


def test_one_label_is_the_best():
    beliefs = label_cells(np.ones((30, 30, 1), np.float32), *uniform(30, 30, 1.0))
    np.testing.assert_array_equal(beliefs, np.zeros((30, 30, 1)))


def blocks(size: int) -> list[slice]:
    return [slice(start, start + 2) for start in range(0, size, 2)]


@pytest.mark.parametrize("shape", [(6, 8), (5, 8), (6, 7), (5, 7), (1, 3)])
def test_merged_cells_cost_what_their_cells_do(shape):
    costs, *_ = random_problem(*shape, 3, 0)
    expected = [[costs[rows, columns].sum(axis=(0, 1)) for columns in blocks(shape[1])] for rows in blocks(shape[0])]
    np.testing.assert_allclose(_merged(costs), expected, rtol=1e-6)


@pytest.mark.parametrize("shape", [(6, 8), (5, 8), (6, 7), (5, 7), (1, 3), (4, 2)])
def test_a_change_between_merged_cells_costs_what_those_of_the_pairs_that_touch_do(shape):
    _, right, down = random_problem(*shape, 3, 0)
    right[:, -1] = down[-1] = 0.0
    across = _merged_across(right)
    assert across.shape == _merged_across(down.T).T.shape == ((shape[0] + 1) // 2, (shape[1] + 1) // 2)
    for i, rows in enumerate(blocks(shape[0])):
        for j in range(across.shape[1] - 1):
            assert across[i, j] == pytest.approx(right[rows, 2 * j + 1].sum(), rel=1e-6)
    assert (across[:, shape[1] // 2 :] == 0).all()


def test_messages_of_merged_cells_are_shared_out_among_their_four():
    coarse = np.arange(24, dtype=np.float32).reshape(2, 2, 3, 2)
    fine = _refined(coarse, 3, 5)
    assert fine.shape == (2, 3, 5, 2)
    for i, j in itertools.product(range(3), range(5)):
        np.testing.assert_array_equal(fine[:, i, j], 0.25 * coarse[:, i // 2, j // 2])


def test_the_best_label_is_the_first_of_least_belief():
    beliefs = np.random.default_rng(0).integers(0, 3, (7, 9, 5)).astype(np.float32)
    best = best_labels(beliefs)
    assert best.dtype == np.int16
    np.testing.assert_array_equal(best, beliefs.argmin(axis=2))
