"""Labels of cells by belief propagation, against the best of all labellings."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from polarmap.densify import labels
from polarmap.densify.labels import label_cells


def energy(label, costs, right, down) -> float:
    label = np.asarray(label).reshape(costs.shape[:2])
    total = np.take_along_axis(costs, label[..., None], axis=2).sum()
    total += (right[:, :-1] * (label[:, 1:] != label[:, :-1])).sum()
    return float(total + (down[:-1] * (label[1:] != label[:-1])).sum())


def problem(rows, columns, count, seed):
    rng = np.random.default_rng(seed)
    return (
        rng.uniform(0, 4, (rows, columns, count)).astype(np.float32),
        rng.uniform(0, 3, (rows, columns)).astype(np.float32),
        rng.uniform(0, 3, (rows, columns)).astype(np.float32),
    )


@pytest.mark.parametrize("shape", [(1, 6), (6, 1)])
def test_a_chain_is_solved_exactly(shape):
    costs, right, down = problem(*shape, 3, seed=1)
    beliefs = label_cells(costs, right, down, rounds=40)
    everything = [(energy(label, costs, right, down), label) for label in product(range(3), repeat=6)]
    least, best = min(everything)
    np.testing.assert_array_equal(beliefs.argmin(axis=2).ravel(), best)
    for cell, label in product(range(6), range(3)):
        with_it = min(e for e, choice in everything if choice[cell] == label)
        assert beliefs.reshape(6, 3)[cell, label] == pytest.approx(with_it - least, abs=1e-3)


def test_a_grid_is_solved_nearly_as_well_as_possible():
    found, best = 0.0, 0.0
    for seed in range(6):
        costs, right, down = problem(2, 4, 3, seed)
        found += energy(label_cells(costs, right, down, rounds=30).argmin(axis=2), costs, right, down)
        best += min(energy(label, costs, right, down) for label in product(range(3), repeat=8))
    assert best - 1e-4 <= found < 1.02 * best


@pytest.mark.parametrize("shape", [(60, 80), (61, 83), (24, 24)])
def test_what_has_no_evidence_takes_the_label_around_it_up_to_an_edge(shape):
    rows, columns = shape
    costs = np.zeros((rows, columns, 3), np.float32)
    costs[..., 2] = 0.01
    costs[rows // 2, 0] = 5.0, 0.0, 5.0  # one cell at either end knows
    costs[rows // 2, -1] = 0.0, 5.0, 5.0
    right, down = np.full(shape, 2.0, np.float32), np.full(shape, 2.0, np.float32)
    edge = 8 * (columns // 24) - 1  # not inside a merged cell, whose labels change together at first
    right[:, edge] = 0.01
    found = label_cells(costs, right, down, rounds=12).argmin(axis=2)
    assert (found[:, : edge + 1] == 1).all() and (found[:, edge + 1 :] == 0).all()


def test_merging_keeps_sums():
    costs, right, _ = problem(5, 7, 2, seed=3)
    merged = labels._merged(costs)
    assert merged.shape == (3, 4, 2)
    np.testing.assert_allclose(merged.sum((0, 1)), costs.sum((0, 1)), rtol=1e-5)
    np.testing.assert_allclose(merged[1, 1], costs[2:4, 2:4].sum((0, 1)), rtol=1e-6)
    across = labels._merged_across(right)
    assert across.shape == (3, 4)
    assert across[1, 0] == pytest.approx(right[2, 1] + right[3, 1])
    assert across[2, 2] == pytest.approx(right[4, 5])


def test_no_input_is_changed():
    costs, right, down = problem(30, 30, 2, seed=4)
    before = [a.copy() for a in (costs, right, down)]
    label_cells(costs, right, down)
    for a, b in zip((costs, right, down), before, strict=True):
        np.testing.assert_array_equal(a, b)
