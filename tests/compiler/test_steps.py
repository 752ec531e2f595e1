"""Tests the steps of building as a graph: what they read is there, in whatever order they come."""

from __future__ import annotations

import json
import random
from dataclasses import replace
from graphlib import TopologicalSorter
from pathlib import Path
from threading import Condition, Event
from typing import Any, get_args, get_type_hints

import pytest

from scenec.compiler.build import STEPS, BuildLog, BuildStep, build
from scenec.compiler.cfg.load import load
from scenec.compiler.draw import draw
from scenec.compiler.emit.batch import write_batch
from scenec.compiler.objects.build import Timed
from scenec.compiler.plan import Plan
from scenec.compiler.views.needed import Keep, Needs
from scenec.schemas.errors import SceneError
from scenec.schemas.threads import at_most
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


def small_plan(folder: Path, outputs: list[str]) -> Plan:
    cfg = small_cfg(samples=1, outputs=outputs)
    sensors = cfg["rigs"]["rover"]["sensors"]
    pose = {"type": "random", "height_m": 1.5, "region_m": [[-6, -5], [6, 5]]}
    cfg["rigs"]["among"] = {"pose": pose, "sensors": sensors}
    return draw(load(write_cfg(folder, cfg)), 1, 0)


def made(plan: Plan, folder: Path) -> tuple[dict[str, bytes], dict[str, Any]]:
    """Files of a batch by path, and the facts of its report."""
    log = BuildLog()
    folder.mkdir()
    write_batch(folder, build(replace(plan), log))
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    return {str(path.relative_to(folder)): path.read_bytes() for path in files}, log.facts


@pytest.mark.parametrize("outputs", [["rgb", "label", "instance"], ["depth"]])
def test_steps_in_any_order_that_what_they_read_allows_make_the_same_stage(
    outputs, tmp_path, monkeypatch
):
    plan = small_plan(tmp_path, outputs)
    files, facts = made(plan, tmp_path / "listed")
    for seed in range(2):
        order = shuffled(random.Random(seed))
        assert order != list(STEPS)
        monkeypatch.setattr("scenec.compiler.build.STEPS", tuple(order))
        again, other = made(plan, tmp_path / str(seed))
        assert again == files
        left_out = [{str(one) for one in of.pop("left_out", [])} for of in (dict(facts), other)]
        assert left_out[0] == left_out[1]
        assert other == {key: value for key, value in facts.items() if key != "left_out"}


def depending(on: int) -> set[int]:
    """Steps that need another, and itself."""
    found, names = {on}, {*STEPS[on].gives}
    for number, step in enumerate(STEPS[on + 1 :], start=on + 1):
        needs = bool(names & {*step.reads})
        found |= {number} if needs else set()
        names = names | {*step.gives} if needs else names - {*step.gives}
    return found


def test_whichever_step_ends_late_and_on_however_many_threads_the_bytes_are_the_same(
    tmp_path, monkeypatch
):
    monkeypatch.setattr("scenec.schemas.threads.ALL", 4)
    plan = small_plan(tmp_path, ["rgb", "label", "instance"])
    with at_most(1):
        files, facts = made(plan, tmp_path / "one")
    run = BuildStep.run
    for late, held in enumerate(STEPS):
        others = len(STEPS) - len(depending(late))
        if others <= late:
            # All before it are done when it begins, and all after it need it.
            continue
        ended, change = [0], Condition()

        def waiting(
            step, state, log, held=held, others=others, ended=ended, change=change
        ) -> tuple[dict[str, Any], Any]:
            found = run(step, state, log)
            with change:
                if step is held:
                    change.wait_for(lambda: ended[0] == others)
                ended[0] += 1
                change.notify_all()
            return found

        monkeypatch.setattr(BuildStep, "run", waiting)
        with at_most(4):
            again, other = made(plan, tmp_path / str(late))
        assert again == files
        assert json.dumps(other) == json.dumps(facts)


def test_of_steps_that_fail_beside_each_other_the_first_of_the_list_is_told(tmp_path, monkeypatch):
    monkeypatch.setattr("scenec.schemas.threads.ALL", 2)
    failed = Event()

    def first(drawn_terrain: Any) -> None:
        failed.wait()
        raise SceneError("the first")

    def second(drawn_terrain: Any) -> None:
        failed.set()
        raise SceneError("the second")

    steps = BuildStep("", first), BuildStep("", second)
    monkeypatch.setattr("scenec.compiler.build.STEPS", steps)
    plan = small_plan(tmp_path, ["depth"])
    with at_most(2), pytest.raises(SceneError, match="the first"):
        build(plan, BuildLog())
