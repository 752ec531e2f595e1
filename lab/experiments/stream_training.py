"""Trains a small network from a stream for two minutes, and plots IoU on frames it never saw.

python lab/experiments/stream_training.py [--seconds S] [--workers N] [-o PICTURE]

Each frame is of a new scene: 60 rocks, three grounds, another sun. The network (three levels of
convolutions, 0.1 million weights, random at first) takes the picture, sRGB in [0, 1], and tells
the class of each pixel. It learns from eight of the last 64 frames at a time, four times for each
that comes; the clock runs from the first frame on. What it is tested on are scenes of other seeds.
Needs the extras `pyrender`, `plots` and `torch`.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn
from torch.nn.functional import cross_entropy, interpolate

import scenec
from scenec.testing.small import small_cfg

CLASSES = ("sky", "ground", "rock")
#: Of scenes to test on; those that are learned from begin at 0.
UNSEEN = range(1_000_000, 1_000_024)
_KEPT, _AT_ONCE, _TIMES, _EVERY_S = 64, 8, 4, 10.0


class Network(nn.Module):
    """Tells classes from a picture by three levels of convolutions, each half as fine."""

    def __init__(self) -> None:
        super().__init__()
        widths = (3, 16, 32, 64)
        self.levels = nn.ModuleList(
            nn.Sequential(
                nn.Conv2d(a, b, 3, stride=2, padding=1), nn.BatchNorm2d(b), nn.ReLU(),
                nn.Conv2d(b, b, 3, padding=1), nn.BatchNorm2d(b), nn.ReLU(),
            )
            for a, b in pairwise(widths)
        )  # fmt: skip
        self.heads = nn.ModuleList(nn.Conv2d(b, 1 + len(CLASSES), 1) for b in widths[1:])

    def forward(self, picture: torch.Tensor) -> torch.Tensor:
        """Returns a score of each class, [n, 1 + classes, h, w], of pictures [n, 3, h, w]."""
        x, scores = picture, []
        for level, head in zip(self.levels, self.heads, strict=True):
            x = level(x)
            scores.append(interpolate(head(x), picture.shape[-2:], mode="bilinear"))
        return torch.stack(scores).sum(0)


def scenes() -> dict[str, Any]:
    """Returns the cfg."""
    cfg = small_cfg(samples=1, outputs=["rgb", "label"])
    cfg["objects"]["rocks"]["count"] = 60
    cfg["rigs"]["rover"]["sensors"]["front"]["resolution"] = [96, 72]
    return cfg


def pairs(**options: Any) -> Iterator[tuple[torch.Tensor, torch.Tensor]]:
    """Yields pictures, float32 [3, h, w] in [0, 1], and classes, int64 [h, w]."""
    for frame in scenec.stream(scenes(), backend="pyrender", color="srgb", **options):
        assert frame.rgb is not None
        classes = torch.from_numpy(frame.labels["class"].astype(np.int64))
        yield torch.from_numpy(np.moveaxis(frame.rgb, -1, 0).copy()), classes


def iou(network: Network, pictures: torch.Tensor, classes: torch.Tensor) -> NDArray[np.float64]:
    """Returns each class's intersection over union, over all pictures."""
    network.eval()
    with torch.no_grad():
        found = network(pictures).argmax(1)
    network.train()
    ids = range(1, 1 + len(CLASSES))
    both = [int(((found == i) & (classes == i)).sum()) for i in ids]
    either = [int(((found == i) | (classes == i)).sum()) for i in ids]
    return np.array(both) / np.maximum(either, 1)


def main() -> None:
    """Trains, and plots."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seconds", type=float, default=120.0)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("-o", "--out", type=Path, default=Path("docs/pictures/stream_iou.png"))
    asked = parser.parse_args()
    torch.manual_seed(1)
    torch.set_num_threads(1)
    unseen = [torch.stack(part) for part in zip(*pairs(seeds=UNSEEN), strict=True)]
    network, rng = Network(), np.random.default_rng(1)
    optimizer = torch.optim.AdamW(network.parameters(), 3e-3)
    rows: list[tuple[float, int, NDArray[np.float64]]] = []
    kept: list[tuple[torch.Tensor, torch.Tensor]] = []
    start = time.perf_counter()
    for count, pair in enumerate(pairs(workers=asked.workers), 1):
        if count == 1:
            start = time.perf_counter()
        kept = [*kept[1 - _KEPT :], pair]
        for _ in range(_TIMES):
            chosen = rng.integers(len(kept), size=_AT_ONCE)
            pictures, classes = (
                torch.stack(part) for part in zip(*(kept[i] for i in chosen), strict=True)
            )
            loss = cross_entropy(network(pictures), classes)
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
        seconds = time.perf_counter() - start
        if seconds >= len(rows) * _EVERY_S or seconds >= asked.seconds:
            rows.append((seconds, count, iou(network, *unseen)))
            told = ", ".join(f"{n} {v:.2f}" for n, v in zip(CLASSES, rows[-1][2], strict=True))
            print(f"{seconds:.0f} s, {count} frames: {told}", flush=True)
        if seconds >= asked.seconds:
            break
    figure, axes = plt.subplots(figsize=(6, 3.2), layout="constrained")
    values = np.array([row[2] for row in rows])
    for name, column in zip(CLASSES, values.T, strict=True):
        axes.plot([row[0] for row in rows], column, marker="o", label=name)
    axes.set(xlabel="seconds of training", ylabel="IoU on unseen scenes", ylim=(0, 1))
    axes.legend()
    axes.grid(alpha=0.3)
    figure.savefig(asked.out, dpi=120)


if __name__ == "__main__":
    main()
