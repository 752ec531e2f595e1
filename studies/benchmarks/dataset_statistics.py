"""What a dataset's statistics cost an export: a frame's part beside reading the frame.

Made-up frames of 640 x 480 with two label levels, depth, and 200 or 2,000 instances. The last line
is what the same counts of pixels cost with ``numpy.unique`` and ``numpy.histogram``.
"""

from __future__ import annotations

import json
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tests"))
from made_output import make_output

from scenec.datasets import bins
from scenec.datasets.source import LoadedFrame, Source
from scenec.datasets.statistics import Statistics, measure

HEIGHT, WIDTH = 480, 640


def main() -> None:
    rows = []
    for count in (200, 2000):
        with tempfile.TemporaryDirectory() as folder:
            out = make_output(
                Path(folder) / "out",
                lambda number, count=count: picture(number, count),
                batches=1,
                cameras=("a",),
                samples=1,
            )
            source = Source(out)
            frame = source.load(source.frames[0])
            part = measure(frame)
            read = best(lambda s=source: s.load(s.frames[0]))
            rows += [
                (count, "read the frame", read, read),
                (count, "digest of its annotation", best(frame.annotation_digest), read),
                (count, "measure it", best(lambda f=frame: measure(f)), read),
                (count, "add it up", best(lambda p=part: Statistics().add(p)), read),
                (count, "numpy.unique, histogram", best(lambda f=frame: by_numpy(f)), read),
            ]
            print(f"{count} instances: {len(json.dumps(part)):,} bytes of JSON a frame")
    print(f"\n{'instances':>9}  {'step':<26}{'ms':>8}{'of reading':>12}")
    for number, name, seconds, read in rows:
        print(f"{number:>9}  {name:<26}{1e3 * seconds:>8.2f}{seconds / read:>12.3f}")


def picture(number: int, count: int) -> dict[str, np.ndarray]:
    """Sky, ground that recedes, and rocks whose sizes follow their distances."""
    rng = np.random.default_rng(number)
    sky = HEIGHT // 3
    depth = np.full((HEIGHT, WIDTH), np.inf, np.float32)
    depth[sky:] = (300.0 / np.arange(1, HEIGHT - sky + 1))[:, None] + rng.uniform(
        0, 0.01, (HEIGHT - sky, WIDTH)
    )
    labels = np.full((HEIGHT, WIDTH), 2, np.uint32)
    surface = np.full((HEIGHT, WIDTH), 20, np.uint32)
    labels[:sky], surface[:sky] = 1, 7
    ids = np.zeros((HEIGHT, WIDTH), np.uint32)
    for rock in range(1, count + 1):
        y, x = int(rng.integers(sky, HEIGHT)), int(rng.integers(0, WIDTH))
        side = 1 + int((y - sky) / 16)
        block = np.s_[y : y + side, x : x + side]
        ids[block], labels[block], surface[block] = rock, 3, 300
    return {
        "rgb": rng.uniform(0, 1, (HEIGHT, WIDTH, 3)).astype(np.float32),
        "label.class": labels,
        "label.surface": surface,
        "instance": ids,
        "depth": depth,
    }


def by_numpy(frame: LoadedFrame) -> None:
    for name in ("label.class", "label.surface"):
        np.unique(frame.passes[name], return_counts=True)
    depth = frame.passes["depth"]
    np.histogram(depth[np.isfinite(depth)], bins.LENGTH.edges)


def best(function: Callable[[], object]) -> float:
    """Least CPU seconds of many calls: what else runs on the machine does not count."""
    seconds = []
    for _ in range(60):
        start = time.thread_time()
        function()
        seconds.append(time.thread_time() - start)
    return min(seconds)


if __name__ == "__main__":
    main()
