"""Chosen objects of a batch dropped onto its ground; their poses as a CSV file to be kept.

Not a part of compiling, whose bytes are the same on every CPU: where things come to rest is not.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from scenec.compiler.build import build_to
from scenec.compiler.cfg.load import Spec, load
from scenec.compiler.draw import draw
from scenec.compiler.mesh.surface import GroundSurface
from scenec.compiler.objects.build import build_objects
from scenec.compiler.plan import Plan
from scenec.compiler.scene.objects import Placed, Scatter
from scenec.compiler.terrain.sources.mesh_surface import MeshSurface
from scenec.schemas.errors import OutputError, ScenecError, SceneError
from scenec.schemas.files import check_output
from scenec.schemas.spelling import nearest, shown
from scenec.schemas.versions import version_of
from scenec.settle.bodies import Body, bodies_of
from scenec.settle.neighborhoods import fall_apart
from scenec.settle.table import write_poses
from scenec.settle.world import Fallen, Options, clearance_m, physics

#: More objects than this are not dropped at once: scattering is for the many.
MOST_OBJECTS = 500
_TYPES = ("placed", "meshes")
#: Classes that things fall onto, where nothing else is said: what is solid.
_SOLID = ("placed", "rocks")


@dataclass(frozen=True)
class SettleReport:
    """What settling did.

    Attributes:
        files: CSV file of each class.
        objects: How many objects were dropped.
        groups: How many groups of neighbors were simulated, each by itself.
        steps: Of all groups together.
        unsettled: Objects of groups that were not at rest when the steps were used up.
        off_terrain: Objects that ended beyond the terrain's border.
        hull_gap_m: How far collision shapes stand off their meshes at most.
        below_ground_m: How deep a vertex of a mesh is below the ground at most.
        above_ground_m: Height over the ground of the lowest vertex of the object that hangs
            highest (on others, or on its hull); 0 where every object has a vertex in the ground.
        overlap_m: How deep collision shapes are in each other at most.
        speed_m_s: The largest speed left, at Earth's gravity.
        ignored: Obstacles that were too small, or too many, to be fallen onto.
        build_seconds, seconds: For building the batch, and for settling.
    """

    files: dict[str, Path]
    objects: int
    groups: int
    steps: int
    unsettled: int
    off_terrain: int
    hull_gap_m: float
    below_ground_m: float
    above_ground_m: float
    overlap_m: float
    speed_m_s: float
    ignored: int
    build_seconds: float
    seconds: float


def settle(
    cfg: Path | str | Spec,
    *,
    seed: int,
    objects: Sequence[str],
    out: Path | str,
    batch: int = 0,
    attempt: int = 0,
    among: Sequence[str] | None = None,
    options: Options | None = None,
    progress: Callable[[str], None] | None = None,
) -> SettleReport:
    """Drops objects onto the ground of a batch, each other and what stands near, until all rest.

    Writes one CSV file a class, for a class of type ``placed`` with the same models in the same
    order, its ``file`` and ``"heights": "world"``. It is an input like any other, to be kept: the
    last digits depend on the CPU and the library, and a heap amplifies them.

    Collision shapes are the convex hulls of a model's connected pieces, or of the whole where
    these are many (``shapes.MOST_PIECES``); density is the same for all.

    Args:
        cfg: The cfg's file, or what ``load`` read of it.
        seed: As of ``compile_cfg``.
        objects: Names of the classes to drop, of type ``placed`` (that do not move) or ``meshes``.
        out: The CSV file; with several classes ``STEM_CLASS.csv`` for each.
        batch: Which batch.
        attempt: How often that was drawn again (``attempt`` in the manifest).
        among: Classes that they may fall onto; None: all of type ``placed`` and ``rocks``.
        options: How they fall.
        progress: Called with lines of text.

    Raises:
        CfgError: The cfg has faults.
        SceneError: It cannot be built, a class cannot be dropped, or the library is missing.
        OutputError: A file cannot be written.
    """
    say = progress or (lambda _text: None)
    options = options or Options()
    _require_sane(options)
    spec = cfg if isinstance(cfg, Spec) else load(cfg)
    chosen = _chosen(spec, objects)
    solid = _among(spec, chosen, among)
    if not 0 <= batch < spec.cfg["batches"]:
        raise ScenecError(
            f"--batch {batch}: the cfg has batches 0 to {int(spec.cfg['batches']) - 1}"
        )
    if not 0 <= attempt < 1 << 31:
        raise ScenecError(f"--attempt {attempt}: expected a whole number from 0 to {(1 << 31) - 1}")
    files = _files(Path(out), chosen)
    library = physics()
    which = f"seed {seed}, batch {batch}" + (f", attempt {attempt}" if attempt else "")
    say(f"building {spec.cfg['name']}, {which}")
    started = time.perf_counter()
    plan = draw(spec, seed, batch, attempt)
    made = build_to(build_objects, plan)
    # The ground with the fines about their feet, as it is meshed.
    surface, laid = made["surface"], made["objects"]
    bodies = _dropped(plan, laid, chosen)
    _require_on_ground(bodies, surface)
    obstacles = [
        body
        for own, one in zip(plan.objects, laid, strict=True)
        if own.name in solid
        for body in bodies_of(own, one, measure=False)
    ]
    built = time.perf_counter()
    say(f"dropping {len(bodies)} objects")
    fallen = fall_apart(bodies, obstacles, surface, options, say)
    settled = [body for group in fallen for body in group.bodies]
    report = _report(files, settled, fallen, surface, built - started, time.perf_counter() - built)
    made_by = (
        f"Made by scenec {version_of()} settle with MuJoCo {library.__version__}: "
        f"{spec.cfg['name']}, {which}, friction {options.friction:g}, "
        f"restitution {options.restitution:g}, {options.cells} cells."
    )
    for name, file in files.items():
        write_poses(
            file,
            [body for body in settled if body.owner == name],
            [
                made_by,
                f'Class {name}. For type "placed", "heights": "world", the same models.',
                "Keep this file: another CPU or library gives other poses.",
            ],
        )
    return report


def _require_sane(options: Options) -> None:
    checks = (
        ("--drop", options.drop_m, 0.0, 1e4, "meters"),
        ("--friction", options.friction, 0.0, 10.0, "a coefficient"),
        ("--restitution", options.restitution, 0.0, 0.9, "a ratio of speeds"),
        ("--cells", options.cells, 2, 64, "cells of the ground across an object"),
        ("--max-steps", options.max_steps, 1, 10_000_000, "steps"),
    )
    for name, value, low, high, what in checks:
        if value is not None and not (low <= value <= high and math.isfinite(value)):
            raise ScenecError(f"{name} {value}: expected {what} from {low:g} to {high:g}")


def _require_class(spec: Spec, name: str, option: str) -> None:
    if name not in spec.cfg["objects"]:
        known = list(spec.cfg["objects"])
        raise SceneError(
            f"{option}: {spec.path}: no class of objects is called {shown(name)}"
            + (nearest(name, known) if known else ": the cfg has no objects")
        )


def _chosen(spec: Spec, objects: Sequence[str]) -> tuple[str, ...]:
    chosen = tuple(dict.fromkeys(objects))
    if not chosen:
        raise SceneError("--objects: no class is named")
    for name in chosen:
        _require_class(spec, name, "--objects")
        kind = spec.cfg["objects"][name]["type"]
        if kind not in _TYPES:
            raise SceneError(
                f"--objects: {spec.path}: objects/{name} is of type {shown(kind)}, which has no "
                "model file for a table of poses to place; expected a class of type "
                f"{' or '.join(shown(t) for t in _TYPES)}"
            )
    return chosen


def _among(spec: Spec, chosen: Sequence[str], among: Sequence[str] | None) -> set[str]:
    if among is None:
        found = {name for name, node in spec.cfg["objects"].items() if node["type"] in _SOLID}
    else:
        for name in among:
            _require_class(spec, name, "--among")
        found = set(among)
    return found.difference(chosen)


def _files(out: Path, chosen: Sequence[str]) -> dict[str, Path]:
    """The file of each class; what cannot be written is said before the work."""
    if out.suffix.lower() != ".csv":
        raise OutputError(f"{out}: expected a file that ends in .csv")
    if len(chosen) == 1:
        files = {chosen[0]: out}
    else:
        files = {name: out.with_name(f"{out.stem}_{name}{out.suffix}") for name in chosen}
    for file in files.values():
        check_output(file)
    return files


def _dropped(plan: Plan, laid: Sequence[Scatter | Placed], chosen: Sequence[str]) -> list[Body]:
    pairs = [(own, one) for own, one in zip(plan.objects, laid, strict=True) if own.name in chosen]
    for _, one in pairs:
        if isinstance(one, Placed) and one.to_world.shape[1] > 1:
            raise SceneError(
                f"--objects: objects/{one.name} moves over time; only what stands still can be "
                "dropped"
            )
        if not one.count:
            raise SceneError(f"--objects: objects/{one.name}: no object of it is placed")
    count = sum(one.count for _, one in pairs)
    if count > MOST_OBJECTS:
        raise SceneError(
            f"--objects: {count:,} objects of {', '.join(chosen)}, expected at most "
            f"{MOST_OBJECTS}: settling is for a chosen few; scattering seats the many"
        )
    return [body for own, one in pairs for body in bodies_of(own, one, measure=True)]


def _off(body: Body, surface: GroundSurface) -> bool:
    width, depth = surface.field.grid.size_m
    x, y, _ = body.center
    return bool(abs(x) > 0.5 * width or abs(y) > 0.5 * depth)


def _require_on_ground(bodies: Sequence[Body], surface: GroundSurface) -> None:
    for body in bodies:
        # The ground for physics is what is seen from above: under a roof it would be the roof.
        roofed = isinstance(surface.field, MeshSurface)
        if roofed and clearance_m(body, surface) < -2.0 * body.radius:
            raise SceneError(
                f"--objects: objects/{body.owner}: object {body.id} stands under a roof of the "
                "terrain's mesh; only what stands on its topmost surface can be dropped"
            )
        if _off(body, surface):
            raise SceneError(
                f"--objects: objects/{body.owner}: object {body.id} at x {body.center[0]:g} m, "
                f"y {body.center[1]:g} m is off the terrain: there is no ground to fall onto"
            )


def _report(
    files: dict[str, Path],
    settled: Sequence[Body],
    fallen: Sequence[Fallen],
    surface: GroundSurface,
    build_seconds: float,
    seconds: float,
) -> SettleReport:
    clearances = [clearance_m(body, surface) for body in settled]
    return SettleReport(
        files=files,
        objects=len(settled),
        groups=len(fallen),
        steps=sum(group.steps for group in fallen),
        unsettled=sum(len(group.bodies) for group in fallen if not group.rested),
        off_terrain=sum(_off(body, surface) for body in settled),
        hull_gap_m=max(body.shape.gap * body.scale for body in settled),
        below_ground_m=max(0.0, -min(clearances)),
        above_ground_m=max(0.0, max(clearances)),
        overlap_m=max(group.overlap_m for group in fallen),
        speed_m_s=max(float(group.speed.max()) for group in fallen),
        ignored=sum(group.ignored for group in fallen),
        build_seconds=build_seconds,
        seconds=seconds,
    )
