"""The way from the command line to a renderer is the one that docs/architecture.md draws."""

from __future__ import annotations

import re
import sys
import threading
import time
from itertools import zip_longest
from pathlib import Path

import counted_backend
import pytest
from counted_backend import CALLS, GO_ON, calls_of
from third_party import square_stage

from scenec.cli.main import main

PAGE = Path(__file__).parents[3] / "docs" / "architecture.md"


def drawn() -> tuple[int, int, list[list[str]]]:
    """How many calls the page counts with workers and without, and whom it draws, by stack."""
    text = PAGE.read_text(encoding="utf-8")
    found = re.search(
        r"it is (\d+) calls with workers, (\d+) with `--workers 0`.*?\n\n((?:    [^\n]*\n)+)",
        text,
        re.S,
    )
    assert found is not None
    lines = found[3].replace("─ pipe ─", "─").splitlines()
    return int(found[1]), int(found[2]), [re.findall(r"[\w.]+(?= [→─]|$)", line) for line in lines]


def names(calls: list[str], like: list[str]) -> list[str]:
    """Names calls as a drawing does, where it names them."""
    pairs = zip_longest(calls, like[: len(calls)], fillvalue="?")
    return [short if f".{call}".endswith(f".{short}") else call for call, short in pairs]


@pytest.mark.parametrize("workers", [0, 1])
def test_the_calls_to_a_renderer_are_those_that_the_page_draws(tmp_path, monkeypatch, workers):
    log = counted_backend.install(tmp_path, monkeypatch)
    stage = square_stage(tmp_path / "square.usda", width=8, samples=1)
    stacks: list[list[str]] = []

    def look() -> None:
        while not log.with_suffix(CALLS).exists():
            time.sleep(0.01)
        try:
            stacks.extend(calls_of(frame) for frame in sys._current_frames().values())
        finally:
            log.with_suffix(GO_ON).touch()

    watcher = threading.Thread(target=look, daemon=True)
    watcher.start()
    words = ["render", str(stage), "--backend", "traced", "--spp", "1", "--workers", str(workers)]
    assert main(words) == 0
    watcher.join()
    inner = log.with_suffix(CALLS).read_text().splitlines()
    with_workers, without, (command, slot, worker) = drawn()
    # The last is the renderer's own, which noted who called it.
    *to_renderer, last = worker
    assert last == "Backend.radiance"
    if not workers:
        way = [*command[:-1], "LocalExecutor.work", *to_renderer[1:]]
        assert names(inner, way) == way
        assert len(way) + 1 == without
        return
    (main_thread,) = (stack for stack in stacks if stack[:1] == ["scenec.cli.main.main"])
    (supervisor,) = (stack for stack in stacks if stack and stack != main_thread)
    assert names(main_thread, command) == command
    # What is below waits for the worker's answer.
    assert names(supervisor[: len(slot)], slot) == slot
    assert inner.pop(0) == "scenec.backends.run.worker.<module>"
    assert names(inner, to_renderer) == to_renderer
    assert len(command) + len(slot) + len(worker) == with_workers
