"""Builds the Scene of a batch from its Plan: a list of steps, each a function in its room.

A step reads values by its parameters' names, and gives some, which later steps read in place of
earlier ones of the same name. What is given does not change, so the list is a graph, too: a step
depends on those that gave last what it reads, and on nothing else but two context variables, the
cache (``cache.memo``) and how many threads a step takes (``schemas.threads``). So steps run on
threads, each once what it reads is there. ``noises`` keep what is computed of them, which changes
no result; ``timed`` knows of time alone.
"""

from __future__ import annotations

import inspect
import time
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, field, replace
from functools import cached_property
from threading import Lock
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.cameras.enclosed import require_open
from scenec.compiler.cameras.rigs import place_free_rigs, place_rigs
from scenec.compiler.light.build import SceneLight, expose_rigs, light_lamps, light_sky
from scenec.compiler.materials.build import finish_materials, prune_scene, select_outputs
from scenec.compiler.mesh import build as mesh
from scenec.compiler.mesh.precision import find_precision
from scenec.compiler.objects.build import (
    build_objects,
    place_filleted,
    place_obstacles,
    shape_objects,
)
from scenec.compiler.plan import Plan, fine_everywhere, needs_of_plan
from scenec.compiler.scene.ground import Ground
from scenec.compiler.scene.light import Lamp
from scenec.compiler.scene.material import Material
from scenec.compiler.scene.objects import Objects
from scenec.compiler.scene.rig import Rig, sample_times
from scenec.compiler.scene.scene import DemOrigin, Scene, require_finite
from scenec.compiler.terrain.program import ReliefResult
from scenec.compiler.terrain.sources.dem import recorded_place
from scenec.compiler.views.needed import Keep, Needs
from scenec.schemas.codec import JSON, Facts
from scenec.schemas.left_out import Record
from scenec.schemas.memory import keep_freed
from scenec.schemas.threads import run_graph

#: Values by name, of the types that the parameters of steps have.
State = Mapping[str, Any]


@dataclass
class BuildLog:
    """Collects what building measured: deterministic facts, and seconds apart from them.

    Attributes:
        facts: For report.json.
        seconds: For timings.json; of steps that run beside each other, each counts.
        tell: Called with the name of each step that begins.
        record: Why each instance is in the Scene or is not; None where none is missing.
    """

    facts: dict[str, JSON] = field(default_factory=dict)
    seconds: dict[str, float] = field(default_factory=dict)
    tell: Callable[[str], None] | None = None
    record: Record | None = None
    _lock: Lock = field(default_factory=Lock, init=False, repr=False, compare=False)

    @contextmanager
    def timed(self, name: str) -> Iterator[None]:
        """Adds the time of a ``with`` block to ``seconds[name]``."""
        if self.tell is not None:
            self.tell(name)
        start = time.perf_counter()
        yield
        with self._lock:
            self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - start

    def join(self, facts: Facts) -> None:
        """Adds a step's facts; what several say of a thing is one object, or one list."""
        for key, value in facts.items():
            if key in self.facts:
                known: Any = self.facts[key]
                self.facts[key] = known | value if isinstance(value, dict) else known + value
            elif value or key != "left_out":
                self.facts[key] = value


@dataclass(frozen=True)
class BuildStep:
    """A step of building.

    Attributes:
        name: What its time counts to; empty where it has none, or tells of it itself.
        function: Returns the values that it gives, then its facts.
        gives: Names of the values.
        color: Whether it has nothing to do where no output shows color.
    """

    name: str
    function: Callable[..., Any]
    gives: tuple[str, ...] = ()
    color: bool = False

    @cached_property
    def reads(self) -> tuple[str, ...]:
        """Names of the values that it reads."""
        return tuple(inspect.signature(self.function).parameters)

    def run(self, given: State, log: BuildLog) -> tuple[dict[str, Any], Facts]:
        """Returns what it gives, by name, and its facts."""
        with log.timed(self.name) if self.name else nullcontext():
            found = self.function(**given)
        *values, facts = found if isinstance(found, tuple) else (found,)
        return dict(zip(self.gives, values, strict=True)), facts or {}


def assemble(
    plan: Plan,
    needs: Needs,
    relief: ReliefResult,
    ground: Ground,
    objects: Objects,
    materials: dict[str, Material],
    light: SceneLight,
    lamps: tuple[Lamp, ...],
    rigs: tuple[Rig, ...],
    bounds: NDArray[np.float64],
) -> tuple[Scene, Facts]:
    """Puts the Scene together."""
    # The first DEM that says where it lies.
    placed: Any = next((step for step in relief.steps if "georeference" in step), None)
    georeference = None
    if placed is not None:
        crs, (east, north) = placed["georeference"]["crs"], placed["georeference"]["center"]
        offset_m = placed["height_offset_m"]
        georeference = DemOrigin(crs, (east, north), offset_m, recorded_place(placed))
    scene = Scene(
        name=plan.name,
        samples=plan.samples,
        times=sample_times(rigs, plan.samples),
        label_table=plan.label_table if needs.labels else {},
        sky_labels=plan.sky_labels if needs.labels else {},
        materials=materials,
        ground=ground,
        objects=objects,
        sun=light.sun,
        sky=light.sky,
        rigs=rigs,
        outputs=tuple(dict.fromkeys(name for rig in plan.rigs for name in rig.outputs)),
        bounds=bounds,
        georeference=georeference,
        more_suns=light.more_suns,
        lamps=lamps,
        haze=light.haze,
        sky_label_maps=light.sky_label_maps,
        sky_labels_below=plan.sky_labels_below if needs.labels else {},
        craters=relief.craters,
    )
    return scene, {}


#: In this order, which is that of report.json, too.
STEPS = (
    BuildStep("relief", mesh.build_relief, ("relief", "noises")),
    BuildStep("cover", mesh.build_surface, ("surface",)),
    BuildStep("light", light_sky, ("light", "irradiance")),
    BuildStep("cameras", place_free_rigs, ("free_rigs",)),
    BuildStep("cameras", place_obstacles, ("obstacles",)),
    BuildStep("cameras", place_rigs, ("rigs",)),
    BuildStep("light", light_lamps, ("light", "lamps"), color=True),
    BuildStep("cameras", expose_rigs, ("rigs",), color=True),
    BuildStep("ground", mesh.see_ground, ("views", "near", "color_views")),
    BuildStep("ground", mesh.build_land, ("land",)),
    BuildStep("", shape_objects, ("shaped", "material_plans")),
    BuildStep("", place_filleted, ("placing", "surface", "filleted")),
    BuildStep("", build_objects, ("objects", "errors_m")),
    BuildStep("ground", mesh.build_ground, ("ground", "ground_error_m", "reached_px")),
    BuildStep("cameras", require_open),
    BuildStep("outputs", select_outputs, ("material_plans", "ground", "objects", "lamps")),
    BuildStep("surfaces", finish_materials, ("materials",), color=True),
    BuildStep("", find_precision, ("bounds",)),
    BuildStep("", mesh.note_plain_mesh),
    BuildStep("", assemble, ("scene",)),
    BuildStep("", require_finite),
    BuildStep("prune", prune_scene, ("scene", "record")),
)


def build(plan: Plan, log: BuildLog, keep: Keep = Keep.SEEN) -> Scene:
    """Builds the Scene of one batch.

    Only what the outputs can show is made (``views.needed``): without ``rgb`` there are no
    materials, weights, or light; without ``label`` the ground is not cut; without ``instance``
    nothing has ids.

    Raises:
        SceneError: The cfg is valid, but what it asks for cannot be built.
    """
    keep_freed()
    state = _drawn(plan, log, keep)
    del plan
    done = _run(STEPS, state, log, ("scene", "record"))
    log.record = done["record"]
    scene: Scene = done["scene"]
    return scene


def _run(
    steps: Sequence[BuildStep], state: dict[str, Any], log: BuildLog, kept: Collection[str]
) -> State:
    """Runs steps as a graph; returns what there is of some names after all of them.

    Args:
        steps: In an order in which they could run.
        state: What there is before them; it is emptied.
        log: Receives facts, in the steps' order.
        kept: The names; anything else is let go of after the last that reads it. Of millions of
            objects what was drawn for them takes more than what became of it.
    """
    steps = [step for step in steps if state["needs"].color or not step.color]
    giver = dict.fromkeys(state, -1)
    # Each value is known by who gave it (-1: nobody did) and its name.
    reads: list[dict[str, tuple[int, str]]] = []
    for number, step in enumerate(steps):
        reads.append({name: (giver[name], name) for name in step.reads})
        giver |= dict.fromkeys(step.gives, number)
    last = {name: (giver[name], name) for name in kept if name in giver}
    readers = Counter(value for of in (*reads, last) for value in of.values())
    known = {(-1, name): value for name, value in state.items() if (-1, name) in readers}
    state.clear()
    facts: dict[int, Facts] = {}

    def run(number: int) -> tuple[dict[str, Any], Facts]:
        return steps[number].run({name: known[of] for name, of in reads[number].items()}, log)

    def take(number: int, result: tuple[dict[str, Any], Facts]) -> None:
        given, facts[number] = result
        known.update(((number, name), value) for name, value in given.items())
        for value in [*reads[number].values(), *((number, name) for name in given)]:
            readers[value] -= value[0] != number
            if not readers[value]:
                del known[value]

    run_graph([{by for by, _ in of.values()} - {-1} for of in reads], run, take)
    for number in sorted(facts):
        log.join(facts[number])
    return {name: known[value] for name, value in last.items()}


def build_to(function: Callable[..., Any], plan: Plan, **given: Any) -> State:
    """Returns what there is once a step, and those that it needs, were run.

    Args:
        function: The step's.
        given: Values that are there already, which no step is run for. Without ``needs``, outputs
            show nothing but shapes; ``log`` receives facts and seconds.

    Raises:
        SceneError: The cfg is valid, but what it asks for cannot be built.
    """
    log = given.pop("log", None) or BuildLog()
    state = {**_drawn(plan, log, Keep.SEEN), "needs": Needs(False, False, False), **given}
    steps: list[BuildStep] = []
    wanted: set[str] = set()
    for step in reversed(STEPS):
        if step.function is function or wanted.intersection(step.gives):
            steps.insert(0, step)
            wanted = wanted.difference(step.gives).union(step.reads) - given.keys()
    return _run(steps, state, log, {*state}.union(*(step.gives for step in steps)))


def _drawn(plan: Plan, log: BuildLog, keep: Keep) -> dict[str, Any]:
    """Returns the values before the first step: ``drawn_…`` for each part of a plan."""
    if keep is Keep.ALL:
        plan = fine_everywhere(plan)
    meshing = plan.terrain.meshing
    return {f"drawn_{name}": value for name, value in vars(plan).items()} | {
        "plan": replace(plan, objects=()),
        "keep": keep,
        "needs": needs_of_plan(plan, keep),
        "timed": log.timed,
        "size_m": plan.terrain.size_m,
        "has_rigs": bool(plan.rigs),
        "unseen": meshing.unseen,
        "finest_m": meshing.finest(plan.terrain.spacing_m),
        "levels": len(plan.label_table),
        "lit": plan.light.lit,
        # Where no output shows color.
        "lamps": (),
        "materials": {},
    }
