"""Whatever a stage's files hold, reading them ends in a ``StageError``, or in a stage.

``python tests/backends/stage/test_damaged_stages.py N`` reads N of each kind.
"""

from __future__ import annotations

import itertools
import os
import shutil
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from hypothesis import settings
from rich_stage import compile_rich

from scenec.backends.stage.read import read_stage
from scenec.testing.damaged_stages import (
    READ,
    REFUSED,
    WRONG,
    attributes,
    flipped,
    outcomes,
    rewritten,
    with_value,
)

#: Of each kind; 15 in the quick profile.
COUNT = 60 * settings().max_examples // 100


def with_wrong_values(stage: Path, count: int, aside: Path) -> Iterator[tuple[str, Path]]:
    """A stage with one attribute of another type, another length, or not finite."""
    every = list(itertools.product(attributes(stage), WRONG))
    rng = np.random.default_rng(1)
    for i in rng.permutation(len(every))[:count].tolist():
        path, kind = every[i]
        yield f"{path} as {kind}", with_value(stage, path, kind, aside / f"wrong_{i}.usda")


def with_damaged_crates(stage: Path, count: int, aside: Path) -> Iterator[tuple[str, Path]]:
    """A stage of which one .usdc has lost bits, bytes, or its end."""

    def damage(file: Path, rng: np.random.Generator) -> bytes:
        return flipped(file.read_bytes(), rng)

    yield from _with_damaged(stage, "*.usdc", damage, count, aside)


def with_damaged_text(stage: Path, count: int, aside: Path) -> Iterator[tuple[str, Path]]:
    """A stage of which one .usda has been edited by a cat."""

    def damage(file: Path, rng: np.random.Generator) -> bytes:
        return rewritten(file.read_text(encoding="utf-8"), rng).encode()

    yield from _with_damaged(stage, "*.usda", damage, count, aside)


def _with_damaged(
    stage: Path,
    pattern: str,
    damage: Callable[[Path, np.random.Generator], bytes],
    count: int,
    aside: Path,
) -> Iterator[tuple[str, Path]]:
    files = sorted(stage.parent.rglob(pattern))
    rng = np.random.default_rng(2)
    for i in range(count):
        folder = aside / f"{pattern[2:]}_{i}"
        shutil.copytree(stage.parent, folder, copy_function=os.link)
        original = files[i % len(files)]
        file = folder / original.relative_to(stage.parent)
        file.unlink()
        file.write_bytes(damage(original, rng))
        yield f"{original.name} number {i}", folder / stage.name


KINDS = (with_wrong_values, with_damaged_crates, with_damaged_text)


def tally(stage: Path, kind: Callable, count: int, aside: Path) -> tuple[Counter[str], list[str]]:
    """How many were read and refused; and a line about each other outcome."""
    cases = list(kind(stage, count, aside))
    found, odd = Counter[str](), []
    for (name, _), (outcome, text) in zip(cases, outcomes([p for _, p in cases]), strict=True):
        found[outcome] += 1
        if outcome not in (READ, REFUSED):
            odd.append(f"{name}: {outcome}: {text}")
    return found, odd


@pytest.fixture(scope="module")
def stage(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return compile_rich(tmp_path_factory.mktemp("rich"))


def test_the_stage_itself_is_sound(stage):
    assert read_stage(stage).losses == ()


@pytest.mark.parametrize("kind", KINDS)
def test_what_is_damaged_is_refused_or_read(stage, tmp_path, kind):
    found, odd = tally(stage, kind, COUNT, tmp_path)
    assert not odd, odd
    # Neither is all refused whatever it is, nor is nothing looked at.
    assert found[READ] > 0
    assert found[REFUSED] > 0


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        made = compile_rich(Path(folder) / "rich")
        for each in KINDS:
            counted, others = tally(made, each, int(sys.argv[1]), Path(folder))
            print(each.__name__, dict(counted), *others[:40], sep="\n  ")
