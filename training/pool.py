"""A pool of rendered samples on disk that training draws from while more are made.

    python -m training.pool POOL --samples 20000 --seed 1

Files shard_NNNNN.npy hold `SHARD` records of `training.views.SAMPLE` each, shard i made from the seed and i alone, so
that a pool goes on where it stopped, and several processes with different `--seed` may fill one folder.
"""

from __future__ import annotations

import argparse
import itertools
import time
from pathlib import Path

import numpy as np

SHARD = 120
_MOST_SHARDS = 100_000


def main() -> None:
    """Fill a folder with shards."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("pool", type=Path)
    parser.add_argument("--samples", type=int, default=20_000)
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    fill(arguments.pool, arguments.samples, arguments.seed)


def fill(pool: Path, count: int, seed: int) -> None:
    """Shards of a seed until they hold `count` samples; those that are there stay."""
    from training.views import samples

    pool.mkdir(parents=True, exist_ok=True)
    for i in range(-(-count // SHARD)):
        path = pool / f"shard_{seed * _MOST_SHARDS + i:09d}.npy"
        if path.exists():
            continue
        start = time.perf_counter()
        shard = np.stack(list(itertools.islice(samples(seed * _MOST_SHARDS + i), SHARD)))
        partial = path.with_suffix(".part")
        with partial.open("wb") as file:
            np.save(file, shard)
        partial.rename(path)
        print(f"{path.name}: {SHARD / (time.perf_counter() - start):.1f} views/s", flush=True)


def shards(pool: Path) -> list[np.ndarray]:
    """The finished shards, mapped from disk."""
    return [np.load(path, mmap_mode="r") for path in sorted(pool.glob("shard_*.npy"))]


if __name__ == "__main__":
    main()
