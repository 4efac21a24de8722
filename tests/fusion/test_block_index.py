"""The hash of voxel blocks against a dictionary."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from polarmap.fusion.block_index import COORDINATE_LIMIT, BlockIndex, coordinates, pack, unpack

coordinate = st.integers(-COORDINATE_LIMIT + 1, COORDINATE_LIMIT - 2)
block = st.tuples(coordinate, coordinate, coordinate)
near_block = st.tuples(*[st.integers(-3, 3)] * 3)


def keys_of(blocks) -> np.ndarray:
    return np.array([pack.py_func(*b) for b in blocks], np.int64)


@given(block)
def test_keys_give_back_their_block(ijk):
    key = pack.py_func(*ijk)
    assert key >= 0
    assert tuple(unpack.py_func(np.int64(key))) == ijk
    assert tuple(coordinates(np.array([key]))[0]) == ijk


@given(block, block)
def test_keys_sort_as_their_blocks(a, b):
    assert (pack.py_func(*a) < pack.py_func(*b)) == (a < b)


@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(st.booleans(), st.sets(near_block, min_size=1, max_size=60)), max_size=12))
def test_index_agrees_with_a_dictionary(operations):
    index, model = BlockIndex(), {}
    for insert, blocks in operations:
        if insert:
            model |= dict(zip(blocks, index.insert(keys_of(blocks)).tolist(), strict=True))
        else:
            present = [b for b in blocks if b in model]
            index.discard(keys_of(present))
            for b in present:
                del model[b]
        everything = [(i, j, k) for i in range(-3, 4) for j in range(-3, 4) for k in range(-3, 4)]
        assert index.find(keys_of(everything)).tolist() == [model.get(b, -1) for b in everything]
        assert index.keys().tolist() == sorted(keys_of(model).tolist())
        assert len(set(model.values())) == len(model) == len(index)


def test_index_grows_and_reuses_slots():
    rng = np.random.default_rng(0)
    keys = np.unique(keys_of(rng.integers(-COORDINATE_LIMIT + 1, COORDINATE_LIMIT - 2, (5000, 3)).tolist()))
    index = BlockIndex()
    slots = index.insert(keys)
    assert np.array_equal(np.sort(slots), np.arange(len(keys)))
    assert np.array_equal(index.insert(keys), slots)
    index.discard(keys[:2000])
    assert (index.find(keys[:2000]) == -1).all()
    assert np.array_equal(index.find(keys[2000:]), slots[2000:])
    index.insert(keys[:1000] + 1)
    assert index.end == len(keys)
