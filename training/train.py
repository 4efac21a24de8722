"""Train the network on a pool of samples, which may still grow meanwhile.

    python -m training.train POOL OUT --minutes 90
    python -m training.train POOL OUT --minutes 600 --resume
    python -m training.train POOL OUT --minutes 60 --start-from src/polarmap/prior/polarnet.onnx

OUT gets `checkpoint.pt` every few minutes, `curve.csv` and `curve.png`. The learning rate falls with a cosine to zero
over the minutes of training, those before a resumption included: a resumed run with more minutes takes it up again
where that longer course has it. Pictures are small first and larger for the last part of the time; the network is
exported for the size that it was trained at last.
"""

from __future__ import annotations

import argparse
import copy
import csv
import math
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import torch
from torch.utils.data import DataLoader, IterableDataset

from training.augmentation import example
from training.losses import Truth, losses
from training.network import PolarNet, parameter_count
from training.pool import shards
from training.validation import validate
from training.warm_start import warm_start

STAGES = "0.65:96x128,1:128x160"
"""Until which share of the time pictures have which height and width."""

_BATCH_PIXELS = 32 * 96 * 128
LEARNING_RATE = 1.5e-3
_WARM_UP = 200  # steps
_WEIGHT_DECAY = 0.02
_CLIP = 1.0  # norm of the gradient
_MEMORY = 0.998  # of the running mean of weights
_RESCAN = 200  # batches after which the pool is looked through for new shards
_REPORT = 25  # steps
_CHECKPOINT = 240.0  # seconds
_WARM_START_EXAMPLES = 128
_PLAIN = 0.35  # share of the views without steps of depth that are taken
_STEP = 0.25  # of the slope of log depth, from each 8th pixel to the next
_STEPS = 0.05  # share of the pixels
_FIELDS = ("seconds", "samples", "height", "rate", "total", "depth", "gradient", "normal", "specular", "variance",
           "scale", "val_polarized", "val_grey")  # fmt: skip


class Batches(IterableDataset):
    """Endless random batches of a pool, the same for the same seed and pool."""

    def __init__(self, pool: Path, size: tuple[int, int], batch: int, seed: int) -> None:
        super().__init__()
        self.pool, self.size, self.batch, self.seed = pool, size, batch, seed

    def __iter__(self) -> Iterator[tuple[torch.Tensor, ...]]:
        import cv2

        cv2.setNumThreads(1)
        rng = np.random.default_rng(self.seed)
        for number in range(1 << 40):
            if number % _RESCAN == 0:
                parts = shards(self.pool)
            yield collate([self._draw(parts, rng) for _ in range(self.batch)])

    def _draw(self, parts: list[np.ndarray], rng: np.random.Generator):
        while True:
            shard = parts[rng.integers(len(parts))]
            sample = shard[rng.integers(len(shard))]
            if rng.random() < (1.0 if has_steps(sample["depth"]) else _PLAIN):
                return example(sample, self.size, rng)


def has_steps(depth: np.ndarray) -> bool:
    """Whether things stand free before others in a view: where they do there is more to learn."""
    log_depth = np.log(np.minimum(depth[::8, ::8].astype(np.float32), 100.0))
    steps = [np.abs(np.diff(log_depth, n=2, axis=axis)) > _STEP for axis in (0, 1)]
    return max(step.mean() for step in steps) > _STEPS


def collate(examples: list) -> tuple[torch.Tensor, ...]:
    """Input, inverse depth, normal, specular and surface as one batch each."""
    return (
        torch.from_numpy(np.stack([e.input for e in examples])),
        torch.from_numpy(np.stack([e.inverse_depth[None] for e in examples])),
        torch.from_numpy(np.stack([e.normal for e in examples])),
        torch.from_numpy(np.stack([e.specular[None] for e in examples])),
        torch.from_numpy(np.stack([e.surface[None] for e in examples])),
    )


class Trainer:
    """Network, running mean of its weights, optimizer, and what has been done so far."""

    def __init__(self, out: Path, minutes: float, seed: int, learning_rate: float = LEARNING_RATE) -> None:
        torch.manual_seed(seed)
        self.out, self.limit, self.seed, self.learning_rate = out, 60.0 * minutes, seed, learning_rate
        self.network = PolarNet().to(memory_format=torch.channels_last)
        self.mean = copy.deepcopy(self.network).eval()
        self.optimizer = torch.optim.AdamW(self._groups(), lr=learning_rate)
        self.seconds, self.samples, self.steps, self.size = 0.0, 0, 0, (0, 0)
        self.rows: list[dict] = []

    def run(self, pool: Path, validation: Path | None, stages: str) -> None:
        """All stages that are left; they are written as STAGES is."""
        print(f"{parameter_count(self.network)} parameters", flush=True)
        for end, self.size in map(_stage, stages.split(",")):
            if self.seconds < end * self.limit:
                self._stage(pool, validation, end * self.limit)
        self.save(validation)

    def save(self, validation: Path | None) -> None:
        """Checkpoint and curve; validated first where there are samples for it."""
        figures = validate(self.mean, validation, self.size) if validation else {}
        if self.rows:
            self.rows[-1].update(figures)
        state = {
            "network": self.network.state_dict(),
            "mean": self.mean.state_dict(),
            "optimizer": self.optimizer.state_dict(),
            "seconds": self.seconds,
            "samples": self.samples,
            "steps": self.steps,
            "size": self.size,
            "rows": self.rows,
        }
        partial = self.out / "checkpoint.part"
        torch.save(state, partial)
        partial.rename(self.out / "checkpoint.pt")
        self._write_curve()
        print(f"{self.seconds:.0f} s, {self.samples} samples, {self.rows[-1] if self.rows else ''}", flush=True)

    def start_from(self, path: Path, pool: Path) -> None:
        """Take the weights of an exported network."""
        data = iter(Batches(pool, (96, 128), _WARM_START_EXAMPLES, self.seed))
        warm_start(self.network, path, next(data)[0])
        self.mean.load_state_dict(self.network.state_dict())

    def resume(self) -> None:
        """Go on from the folder's checkpoint."""
        state = torch.load(self.out / "checkpoint.pt", weights_only=True)
        self.network.load_state_dict(state["network"])
        self.mean.load_state_dict(state["mean"])
        self.optimizer.load_state_dict(state["optimizer"])
        self.seconds, self.samples, self.steps = state["seconds"], state["samples"], state["steps"]
        self.rows = state["rows"]

    def _groups(self) -> list[dict]:
        weights = [p for p in self.network.parameters() if p.dim() > 1]
        others = [p for p in self.network.parameters() if p.dim() <= 1]
        return [{"params": weights, "weight_decay": _WEIGHT_DECAY}, {"params": others, "weight_decay": 0.0}]

    def _stage(self, pool: Path, validation: Path | None, end: float) -> None:
        batch = max(_BATCH_PIXELS // (self.size[0] * self.size[1]), 8)
        data = Batches(pool, self.size, batch, self.seed + self.steps)
        loader = iter(DataLoader(data, batch_size=None, num_workers=1, prefetch_factor=6))
        saved, sums = self.seconds, []
        self.network.train()
        while self.seconds < end:
            start = time.perf_counter()
            sums.append(self._step(next(loader)))
            self.samples += batch
            self.seconds += time.perf_counter() - start
            if self.steps % _REPORT == 0:
                self._report(sums)
                sums = []
            if self.seconds - saved > _CHECKPOINT:
                self.save(validation)
                saved = self.seconds

    def _step(self, batch: tuple[torch.Tensor, ...]) -> dict[str, float]:
        rate = self.learning_rate * min(1.0, (self.steps + 1) / _WARM_UP)
        rate *= 0.5 + 0.5 * math.cos(math.pi * min(self.seconds / self.limit, 1.0))
        for group in self.optimizer.param_groups:
            group["lr"] = rate
        x = batch[0].contiguous(memory_format=torch.channels_last)
        with torch.autocast("cpu", dtype=torch.bfloat16):
            outputs = self.network(x)
        parts = losses(outputs, Truth(*batch[1:]))
        self.optimizer.zero_grad(set_to_none=True)
        parts["total"].backward()
        norm = torch.nn.utils.clip_grad_norm_(self.network.parameters(), _CLIP)
        if torch.isfinite(norm):
            self.optimizer.step()
            self._follow()
        self.steps += 1
        return {"rate": rate, **{name: float(part.detach()) for name, part in parts.items()}}

    @torch.no_grad()
    def _follow(self) -> None:
        memory = min(_MEMORY, (1 + self.steps) / (10 + self.steps))
        for mean, now in zip(self.mean.state_dict().values(), self.network.state_dict().values(), strict=True):
            if mean.dtype.is_floating_point:
                mean.lerp_(now, 1.0 - memory)
            else:
                mean.copy_(now)

    def _report(self, sums: list[dict]) -> None:
        row = {"seconds": round(self.seconds, 1), "samples": self.samples, "height": self.size[0]}
        row.update({name: round(float(np.mean([s[name] for s in sums])), 6) for name in sums[0]})
        self.rows.append(row)

    def _write_curve(self) -> None:
        with (self.out / "curve.csv").open("w", newline="") as file:
            writer = csv.DictWriter(file, _FIELDS)
            writer.writeheader()
            writer.writerows(self.rows)
        _plot(self.rows, self.out / "curve.png")


def _stage(text: str) -> tuple[float, tuple[int, int]]:
    """(share of the time, (height, width)) of a part of STAGES."""
    share, _, size = text.partition(":")
    height, width = map(int, size.split("x"))
    return float(share), (height, width)


def _plot(rows: list[dict], path: Path) -> None:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8, 4.5), layout="constrained")
    axes = figure.add_subplot()
    samples = [row["samples"] / 1000 for row in rows]
    depth = [row["depth"] for row in rows]
    smooth = [np.nanmean(depth[max(i - 10, 0) : i + 11]) for i in range(len(depth))]
    axes.plot(samples, smooth, label="in training, as the loss counts it", color="0.6")
    for key, label in (("val_polarized", "held-out scenes, polarized"), ("val_grey", "held-out scenes, grey")):
        points = [(row["samples"] / 1000, row[key]) for row in rows if key in row]
        if points:
            axes.plot(*zip(*points, strict=True), "o-", ms=3, label=label)
    axes.set(xlabel="thousand examples", ylabel="relative error of inverse depth after the affine fit", ylim=(0, None))
    axes.legend()
    axes.grid(alpha=0.3)
    figure.savefig(path, dpi=110)


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("pool", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--minutes", type=float, default=90.0)
    parser.add_argument("--validation", type=Path, help="a pool of other seeds")
    parser.add_argument("--stages", default=STAGES, help=f"shares of the time and sizes of pictures ({STAGES})")
    parser.add_argument("--learning-rate", type=float, default=LEARNING_RATE, help=f"at its highest ({LEARNING_RATE})")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--threads", type=int, default=1)
    start = parser.add_mutually_exclusive_group()
    start.add_argument("--resume", action="store_true", help="go on from OUT's checkpoint")
    start.add_argument("--start-from", type=Path, metavar="ONNX", help="begin with the weights of an exported network")
    arguments = parser.parse_args()
    torch.set_num_threads(arguments.threads)
    arguments.out.mkdir(parents=True, exist_ok=True)
    trainer = Trainer(arguments.out, arguments.minutes, arguments.seed, arguments.learning_rate)
    if arguments.resume:
        trainer.resume()
    elif arguments.start_from:
        trainer.start_from(arguments.start_from, arguments.pool)
    trainer.run(arguments.pool, arguments.validation, arguments.stages)


if __name__ == "__main__":
    main()
