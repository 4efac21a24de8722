"""Voxel-block hashing: which storage slot holds the block at integer coordinates (i, j, k).

After Nießner et al. 2013, "Real-time 3D Reconstruction at Scale using Voxel Hashing". Coordinates are packed into
one 64-bit key, and an open-addressing table with linear probing holds key and slot.
"""

from __future__ import annotations

import numpy as np

from polarmap.jit import njit

BLOCK_SIDE = 8
"""Voxels along each side of a block."""

COORDINATE_LIMIT = 1 << 20
"""Block coordinates lie in (-COORDINATE_LIMIT, COORDINATE_LIMIT - 1), so that a neighbour's key exists too."""

EMPTY = np.int64(-1)
STEP_I, STEP_J, STEP_K = 1 << 42, 1 << 21, 1
"""What to add to a key to reach the next block along each axis."""


@njit(inline="always")
def pack(i, j, k):
    """Key, int64 >= 0, of block (i, j, k); keys sort as (i, j, k) do."""
    limit = np.int64(COORDINATE_LIMIT)
    return ((np.int64(i) + limit) << 42) | ((np.int64(j) + limit) << 21) | (np.int64(k) + limit)


@njit(inline="always")
def unpack(key):
    """(i, j, k) of a key."""
    limit, mask = np.int64(COORDINATE_LIMIT), np.int64((1 << 21) - 1)
    return (key >> 42) - limit, ((key >> 21) & mask) - limit, (key & mask) - limit


def coordinates(keys: np.ndarray) -> np.ndarray:
    """Block coordinates of keys (N,), int32 N×3."""
    return np.stack(unpack.py_func(keys), axis=-1).astype(np.int32)


@njit(inline="always")
def probe(table, key):
    """Where `key` stands in a table of keys, or the empty place where it belongs; sizes are powers of two."""
    h = np.uint64(key)
    h = (h ^ (h >> np.uint64(32))) * np.uint64(0x9E3779B97F4A7C15)
    mask = np.int64(table.shape[0] - 1)
    place = np.int64(h >> np.uint64(32)) & mask
    while table[place] != EMPTY and table[place] != key:
        place = (place + 1) & mask
    return place


@njit
def _find(table, table_slots, keys, slots):
    for n in range(keys.shape[0]):
        place = probe(table, keys[n])
        slots[n] = table_slots[place] if table[place] == keys[n] else -1


@njit
def _store(table, table_slots, keys, slots):
    for n in range(keys.shape[0]):
        place = probe(table, keys[n])
        table[place] = keys[n]
        table_slots[place] = slots[n]


class BlockIndex:
    """Hash from block keys to slots 0, 1, 2, ...; the slots of discarded blocks are given out again first."""

    def __init__(self) -> None:
        self._slot_keys = np.full(256, EMPTY)
        self._free = np.empty(0, np.int32)
        self._end = 0
        self._rebuild(1024)

    def __len__(self) -> int:
        return self._end - len(self._free)

    @property
    def end(self) -> int:
        """One more than the largest slot ever given out."""
        return self._end

    @property
    def bytes(self) -> int:
        """Memory held by the index."""
        return sum(a.nbytes for a in (self._slot_keys, self._free, self._table, self._table_slots))

    def keys(self) -> np.ndarray:
        """Keys of all blocks, int64, ascending."""
        used = self._slot_keys[: self._end]
        return np.sort(used[used != EMPTY])

    def find(self, keys: np.ndarray) -> np.ndarray:
        """Slots of int64 keys (N,), int32, -1 where there is no such block."""
        slots = np.empty(len(keys), np.int32)
        _find(self._table, self._table_slots, np.ascontiguousarray(keys), slots)
        return slots

    def insert(self, keys: np.ndarray) -> np.ndarray:
        """Slots of distinct keys (N,), int32; blocks that are not there yet are added."""
        slots = self.find(keys)
        new = slots < 0
        slots[new] = self._take(int(new.sum()))
        self._slot_keys[slots[new]] = keys[new]
        if 2 * len(self) > len(self._table):
            self._rebuild(1 << (4 * len(self)).bit_length())
        else:
            _store(self._table, self._table_slots, keys[new], slots[new])
        return slots

    def discard(self, keys: np.ndarray) -> None:
        """Forget distinct blocks, all of which must be there; their slots become free."""
        slots = self.find(keys)
        self._slot_keys[slots] = EMPTY
        self._free = np.concatenate([self._free, slots])
        self._rebuild(len(self._table))  # cheaper than tombstones, for blocks are rarely discarded

    def _take(self, count: int) -> np.ndarray:
        reused, self._free = self._free[:count], self._free[count:]
        start = self._end
        self._end += count - len(reused)
        if self._end > len(self._slot_keys):
            grown = np.full(2 * self._end, EMPTY)
            grown[:start] = self._slot_keys[:start]
            self._slot_keys = grown
        return np.concatenate([reused, np.arange(start, self._end, dtype=np.int32)])

    def _rebuild(self, size: int) -> None:
        self._table = np.full(size, EMPTY)
        self._table_slots = np.empty(size, np.int32)
        slots = np.flatnonzero(self._slot_keys[: self._end] != EMPTY).astype(np.int32)
        _store(self._table, self._table_slots, self._slot_keys[slots], slots)
