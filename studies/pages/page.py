"""What the scripts that write pages share: tables, plots, times, options."""

from __future__ import annotations

import argparse
import importlib.metadata
import os
import sys
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from scenec.compiler.terrain.grid import Grid

ROOT = Path(__file__).resolve().parents[2]
# What tests have to look at, pages show.
sys.path[:0] = [str(ROOT / "tests"), str(ROOT / "tests" / "backends")]


@dataclass(frozen=True)
class Page:
    """Where a page goes.

    Attributes:
        name: Of the page, without suffix; its plots' names begin with it.
        folder: Of the page; plots go to ``pictures`` below it.
        fast: Whether to spare time: one reading a time, fewer and smaller cases.
    """

    name: str
    folder: Path
    fast: bool

    @classmethod
    def of_command_line(cls, name: str) -> Page:
        """By the options ``--out`` and ``--fast``."""
        parser = argparse.ArgumentParser(description=f"Writes {name}.md.")
        parser.add_argument("--out", type=Path, default=ROOT / "docs", help="folder of the page")
        parser.add_argument("--fast", action="store_true", help="fewer cases, to see that it works")
        options = parser.parse_args()
        (options.out / "pictures").mkdir(parents=True, exist_ok=True)
        return cls(name, options.out, options.fast)

    def timed(self, work: Callable[[], object], repeat: int = 3) -> float:
        """Best of some runs, seconds."""
        best = np.inf
        for _ in range(1 if self.fast else repeat):
            start = time.perf_counter()
            work()
            best = min(best, time.perf_counter() - start)
        return float(best)

    def picture(self, name: str) -> Path:
        """The file of a picture."""
        return self.folder / "pictures" / f"{self.name}_{name}.png"

    def save(self, figure: Figure, name: str) -> str:
        """Writes a plot; returns the Markdown that shows it."""
        import matplotlib.pyplot as plt

        figure.tight_layout()
        figure.savefig(self.picture(name), dpi=90, metadata={"Software": None})
        plt.close(figure)
        return f"![{name.replace('_', ' ')}](pictures/{self.picture(name).name})\n"

    def write(self, head: str, packages: Iterable[str], parts: Iterable[Callable[[], str]]) -> None:
        """Makes the parts and writes the page; says what each took.

        Args:
            head: With the places ``{cores}`` and ``{versions}``.
            packages: Whose versions matter.
            parts: Each returns Markdown that begins with its heading.
        """
        versions = ", ".join(f"{name} {importlib.metadata.version(name)}" for name in packages)
        texts = [head.format(cores=os.cpu_count(), versions=versions)]
        for part in parts:
            start = time.perf_counter()
            texts.append(part())
            title = next(line for line in texts[-1].splitlines() if line.startswith("#"))
            print(f"{time.perf_counter() - start:6.1f} s  {title}", file=sys.stderr, flush=True)
        (self.folder / f"{self.name}.md").write_text("\n".join(texts), encoding="utf-8")


def table(header: list[str], rows: list[list[str]]) -> str:
    """A Markdown table."""
    lines = ["| " + " | ".join(header) + " |", "|" + "---|" * len(header)]
    return "\n".join(lines + ["| " + " | ".join(row) + " |" for row in rows]) + "\n"


def flat(grid: Grid) -> NDArray:
    """A plane at 0."""
    return np.zeros(grid.shape)


def shaded(
    height: NDArray, spacing: float, azimuth: float = 315.0, elevation: float = 30.0
) -> NDArray:
    """Hillshade: Lambert's cosine under a sun, gray uint8, north up."""
    gy, gx = np.gradient(height, spacing)
    a, e = np.deg2rad(azimuth), np.deg2rad(elevation)
    toward = (np.sin(a) * np.cos(e), np.cos(a) * np.cos(e), np.sin(e))
    cosine = (-gx * toward[0] - gy * toward[1] + toward[2]) / np.sqrt(1.0 + gx * gx + gy * gy)
    gray = np.clip(0.55 * cosine / np.sin(e), 0.0, 1.0) ** 0.7
    # Few levels, for small files.
    return (np.round(gray * 48.0) * (255.0 / 48.0)).astype(np.uint8)[::-1]
