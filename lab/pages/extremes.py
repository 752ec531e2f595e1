"""Makes the tables of docs/extremes.md: cameras at their limits, cfg to checked frames.

    python lab/pages/extremes.py [--fast] [-o FOLDER]

Seconds and memory are single readings on the machine that runs it; errors are facts of the code.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.backends.camera.rays import camera_rays
from scenec.backends.check.compare import check_exact
from scenec.backends.check.witness import Witness, ask
from scenec.backends.exact import ExactCaster
from scenec.backends.run.plan import RenderPlan
from scenec.backends.run.render import render
from scenec.backends.run.session import Session
from scenec.backends.stage.read import read_stage
from scenec.backends.stage.scene import Camera, RenderScene
from scenec.compiler.compile import compile_cfg
from scenec.lab.runner import Page, apart, run
from scenec.schemas.frames import Frame, frame_stem, read_frame
from scenec.schemas.manifest import find_batches
from scenec.testing.extreme_scenes import (
    CASES,
    GROUND,
    extreme_cfg,
    true_plane,
)

BACKENDS = ("annotation", "mitsuba", "cycles", "pyrender")
DRAWING = BACKENDS[1:]
PASSES = ("label", "instance", "depth", "range")
#: Rays along a pixel's side by which its exact coverage is told.
FINE = 8
SPP = 16


@dataclass
class Drawn:
    """The frames of all cases.

    Attributes:
        folder: Of the output.
        scene: Its stage.
        frames: By backend and case.
        seen: Pixels that a renderer itself sees otherwise, by backend and case, in words.
        cameras: By case.
    """

    folder: Path
    scene: RenderScene
    frames: dict[tuple[str, str], Frame] = field(default_factory=dict)
    seen: dict[tuple[str, str], str] = field(default_factory=dict)
    cameras: dict[str, Camera] = field(default_factory=dict)


def draw_cases(page: Page) -> Drawn:
    """Compiles and renders all cases with all backends, and asks renderers for their own hits."""
    start = time.process_time()
    out = compile_cfg(extreme_cfg(page.scratch), seed=1, out=page.scratch / "out").out
    page.value("compiled", f"{time.process_time() - start:.1f} CPU s")
    (batch,) = find_batches(out)
    folder = out / "batch_0000"
    drawn = Drawn(out, read_stage(folder / "stage.usda"))
    caster, cameras = ExactCaster(drawn.scene), drawn.scene.cameras[0]
    drawn.cameras = {camera.name.removesuffix("_eye"): camera for camera in cameras}
    for backend in BACKENDS:
        # What a backend cannot draw has its annotation.
        of = {case.name: "annotation" if backend in case.limits else backend for case in CASES}
        for by in dict.fromkeys(of.values()):
            names = [f"{name}_eye" for name, one in of.items() if one == by]
            passes = PASSES if by == "annotation" else ("rgb", *PASSES)
            render(out, by, spp=SPP, passes=passes, cameras=names)
        for name, by in of.items():
            drawn.frames[backend, name] = read_frame(frame_stem(folder, by, f"{name}_eye", 0))
        if backend not in DRAWING:
            continue
        told = ask(batch, RenderPlan(backend, ("rgb",)), [(0, i) for i in range(len(cameras))])
        for (name, camera), seen in zip(drawn.cameras.items(), told, strict=True):
            found = Witness()
            if seen is not None:
                found.add(caster, camera_rays(camera), seen)
            drawn.seen[backend, name] = "-" if seen is None else str(found.differing)
    return drawn


def annotation(page: Page, drawn: Drawn) -> None:
    """Against the closed form, and against the definition."""
    rows = []
    for case in CASES:
        camera = drawn.cameras[case.name]
        truth = drawn.frames["annotation", case.name].passes
        hit, parameter = true_plane(camera)
        ground, shown = truth["label.class"] == GROUND, np.isfinite(truth["range"])
        wrong = int((ground & ~hit).sum() + (hit & ~shown).sum())
        both = ground & hit
        error = _depth_error(drawn, camera, parameter, both)
        row = [case.what, f"{camera.width} × {camera.height}", f"{int(both.sum()):,}", str(wrong)]
        row.append("none seen" if error is None else f"{error:.0e}")
        for backend in DRAWING:
            frame = drawn.frames[backend, case.name]
            after = sum(
                int((frame.passes[name] != truth[name]).sum()) for name in truth if name != "rgb"
            )
            row.append(f"{drawn.seen[backend, case.name]} → {after}")
        rows.append(row)
    agreement = check_exact(drawn.folder)
    values = sum(one.pixels for one in agreement.comparisons)
    differ = f"{values:,} values of {agreement.frames} frames, {agreement.differing} differ"
    page.value("exact", differ)
    page.rows(rows)


def _depth_error(
    drawn: Drawn, camera: Camera, parameter: NDArray, where: NDArray[np.bool_]
) -> float | None:
    """The largest relative error of ray parameters in float64, or None where there is none."""
    if not where.any():
        return None
    caster = ExactCaster(drawn.scene)
    found = caster.cast(camera_rays(camera))[2].reshape(where.shape)
    return float((np.abs(found[where] - parameter[where]) / parameter[where]).max())


def light(page: Page, drawn: Drawn) -> None:
    """Radiance: finite, covering what it should, as bright as another renderer's."""
    stage = drawn.folder / "batch_0000" / "stage.usda"
    inside = {name: _covered(drawn.scene, camera) for name, camera in drawn.cameras.items()}
    found: dict[str, dict[str, Any]] = {}
    for backend in DRAWING:
        wanted = [case.name for case in CASES if backend not in case.limits]
        found[backend] = apart(_radiance, stage, backend, wanted).value
    rows = []
    for case in CASES:
        share = inside[case.name]
        whole, none = share == 1.0, _far_from(share > 0.0)
        row = [case.what, f"{float(share.mean()):.3f}"]
        base = _mean(found["mitsuba"][case.name], whole)
        for backend in DRAWING:
            if case.name not in found[backend]:
                row.append("no: below")
                continue
            part = found[backend][case.name]
            finite = bool(np.isfinite(part["light"]).all())
            wrong = int((whole & (part["coverage"] < 1.0)).sum())
            wrong += int((none & (part["coverage"] > 0.0)).sum())
            mean = _mean(part, whole)
            ratio = "sky" if mean is None or not base else f"{mean / base:.3f}"
            ratio += "" if finite else ", NOT FINITE"
            row.append(f"{ratio} · {part['coverage'].mean():.3f} · {wrong}")
        rows.append(row)
    page.rows(rows)
    # The last table names tests.
    page.rows(None)


def _mean(part: dict[str, Any], whole: NDArray[np.bool_]) -> float | None:
    return float(part["light"][whole].mean()) if whole.any() else None


def _covered(scene: RenderScene, camera: Camera) -> NDArray[np.float64]:
    """Measures what surfaces fill of each pixel by a lattice of exact rays, [h, w]."""
    k = camera.intrinsics.copy()
    k[:2] *= FINE
    fine = replace(camera, width=FINE * camera.width, height=FINE * camera.height, intrinsics=k)
    hit = np.isfinite(ExactCaster(scene).cast(camera_rays(fine))[2])
    shape = (camera.height, FINE, camera.width, FINE)
    return hit.reshape(shape).mean(axis=(1, 3))


def _far_from(some: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Pixels none of whose neighbors are among some."""
    wide = np.pad(some, 1)
    h, w = some.shape
    near = np.logical_or.reduce([wide[y : y + h, x : x + w] for y in range(3) for x in range(3)])
    return ~near


def _radiance(stage: Path, backend: str, wanted: list[str]) -> dict[str, Any]:
    session = Session.open(stage, backend)
    session.backend.load(session.scene)
    found = {}
    for camera in session.scene.cameras[0]:
        name = camera.name.removesuffix("_eye")
        if name not in wanted:
            continue
        radiance = session.draw(camera, 0, SPP, 1, False, None, {}).radiance
        found[name] = {"light": radiance.halves.mean(axis=0), "coverage": radiance.coverage}
    return found


def main(page: Page) -> None:
    """Refreshes the page."""
    drawn = draw_cases(page)
    packages = ("numpy", "mitsuba", "bpy", "pyrender-maintained")
    page.refresh(packages, [partial(annotation, drawn=drawn), partial(light, drawn=drawn)])


if __name__ == "__main__":
    run(main, page="extremes")
