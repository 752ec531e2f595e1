"""Tests the steps of building as a graph: what they read is there, in whatever order they come."""

from __future__ import annotations

import random
from dataclasses import replace
from graphlib import TopologicalSorter
from pathlib import Path
from typing import Any, get_args, get_type_hints

import pytest

from scenec.compiler.build import STEPS, BuildLog, build
from scenec.compiler.cfg.load import load
from scenec.compiler.draw import draw
from scenec.compiler.emit.batch import write_batch
from scenec.compiler.objects.build import Timed
from scenec.compiler.plan import Plan
from scenec.compiler.views.needed import Keep, Needs
from scenec.testing.small import small_cfg, write_cfg

#: Values before the first step, beside those of the plan.
BEFORE = {
    "plan": Plan, "keep": Keep, "needs": Needs, "timed": Timed, "size_m": tuple[float, float],
    "has_rigs": bool, "unseen": float, "finest_m": float, "levels": int, "lit": bool,
}  # fmt: skip


def given(step: Any) -> dict[str, Any]:
    *kinds, _ = get_args(get_type_hints(step.function)["return"]) if step.gives else (None,)
    return dict(zip(step.gives, kinds, strict=True))


def test_each_step_reads_what_was_drawn_or_given_before_as_it_was_typed():
    known = BEFORE | {f"drawn_{name}": kind for name, kind in get_type_hints(Plan).items()}
    # Given where an output shows color; else there are none.
    known |= {name: kind for step in STEPS if step.color for name, kind in given(step).items()}
    for step in STEPS:
        hints = get_type_hints(step.function)
        assert {name: known[name] for name in step.reads} == {n: hints[n] for n in step.reads}
        known |= given(step)


def shuffled(chance: random.Random) -> list[Any]:
    """The steps in an order that their reads and gives allow."""
    graph: dict[int, set[int]] = {}
    for number, step in enumerate(STEPS):
        before = graph[number] = set()
        for other, earlier in enumerate(STEPS[:number]):
            # It reads what that gives, or gives anew what that reads or gives.
            shared = {*step.reads, *step.gives} & {*earlier.gives} or {*step.gives} & {
                *earlier.reads
            }
            before |= {other} if shared else set()
    order = TopologicalSorter(graph)
    order.prepare()
    found: list[Any] = []
    ready: list[int] = []
    while order.is_active():
        ready += order.get_ready()
        number = ready.pop(chance.randrange(len(ready)))
        found.append(STEPS[number])
        order.done(number)
    return found


@pytest.mark.parametrize("outputs", [["rgb", "label", "instance"], ["depth"]])
def test_steps_in_any_order_that_what_they_read_allows_make_the_same_stage(
    outputs, tmp_path, monkeypatch
):
    cfg = small_cfg(samples=1, outputs=outputs)
    sensors = cfg["rigs"]["rover"]["sensors"]
    pose = {"type": "random", "height_m": 1.5, "region_m": [[-6, -5], [6, 5]]}
    cfg["rigs"]["among"] = {"pose": pose, "sensors": sensors}
    plan = draw(load(write_cfg(tmp_path, cfg)), 1, 0)

    def made(folder: Path) -> tuple[dict[str, bytes], dict[str, Any]]:
        log = BuildLog()
        folder.mkdir()
        write_batch(folder, build(replace(plan), log))
        files = sorted(path for path in folder.rglob("*") if path.is_file())
        return {str(path.relative_to(folder)): path.read_bytes() for path in files}, log.facts

    files, facts = made(tmp_path / "listed")
    for seed in range(2):
        order = shuffled(random.Random(seed))
        assert order != list(STEPS)
        monkeypatch.setattr("scenec.compiler.build.STEPS", tuple(order))
        again, other = made(tmp_path / str(seed))
        assert again == files
        left_out = [{str(one) for one in of.pop("left_out", [])} for of in (dict(facts), other)]
        assert left_out[0] == left_out[1]
        assert other == {key: value for key, value in facts.items() if key != "left_out"}
