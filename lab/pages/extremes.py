"""Writes docs/extremes.md: cameras at their limits, cfg to checked frames, in every renderer.

    python lab/pages/extremes.py [--fast] [-o FOLDER]

Seconds and memory are single readings on the machine that runs it; errors are facts of the code.
"""

from __future__ import annotations

import hashlib
import time
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.backends.camera import tiles
from scenec.backends.camera.rays import camera_rays
from scenec.backends.check.compare import check_exact
from scenec.backends.check.witness import Witness, ask
from scenec.backends.exact import ExactCaster
from scenec.backends.run import memory
from scenec.backends.run.plan import RenderPlan
from scenec.backends.run.render import render
from scenec.backends.run.session import Session
from scenec.backends.stage.read import read_stage
from scenec.backends.stage.scene import Camera, RenderScene
from scenec.compiler.compile import compile_cfg
from scenec.lab.runner import Page, apart, run, table
from scenec.schemas.errors import ScenecError
from scenec.schemas.exr import write_exr
from scenec.schemas.frames import Frame, frame_stem, read_frame
from scenec.schemas.manifest import find_batches
from scenec.schemas.memory import GB
from scenec.testing.extreme_scenes import (
    CASES,
    GROUND,
    extreme_cfg,
    many_poses_cfg,
    near_and_far_stage,
    true_plane,
)
from scenec.testing.small import small_cfg, write_cfg

BACKENDS = ("annotation", "mitsuba", "cycles", "pyrender")
DRAWING = BACKENDS[1:]
PASSES = ("label", "instance", "depth", "range")
#: Rays along a pixel's side by which its exact coverage is told.
FINE = 8
SPP = 16

HEAD = """# Cameras at their limits

This page tries cameras at the ends of every range. Each case goes the whole way: cfg, `scenec
compile`, `scenec render` with every backend, `scenec check --exact`. {cores} cores, shared with
other work ({versions}): seconds are single readings and tell the order of magnitude only.
`tests/backends/test_extremes.py` tests the same facts.
"""


@dataclass
class Drawn:
    """What came of the cases.

    Attributes:
        folder: Of the output.
        scene: Its stage.
        frames: By backend and case.
        seen: Pixels that a renderer itself sees otherwise, by backend and case, in words.
        refusals: What a backend said it cannot draw, by backend and case.
        cameras: By case.
        compile_s: Seconds of compiling.
    """

    folder: Path
    scene: RenderScene
    frames: dict[tuple[str, str], Frame] = field(default_factory=dict)
    seen: dict[tuple[str, str], str] = field(default_factory=dict)
    refusals: dict[tuple[str, str], str] = field(default_factory=dict)
    cameras: dict[str, Camera] = field(default_factory=dict)
    compile_s: float = 0.0


def draw_cases(page: Page) -> Drawn:
    """Compiles and renders all cases with all backends."""
    start = time.perf_counter()
    out = compile_cfg(extreme_cfg(page.scratch), seed=1, out=page.scratch / "out").out
    compiled = time.perf_counter() - start
    batch = out / "batch_0000"
    drawn = Drawn(out, read_stage(batch / "stage.usda"), compile_s=compiled)
    drawn.cameras = {camera.name.removesuffix("_eye"): camera for camera in drawn.scene.cameras[0]}
    for backend in BACKENDS:
        limited = [case for case in CASES if backend in case.limits]
        for case in limited:
            try:
                render(out, backend, spp=2, cameras=[f"{case.name}_eye"])
            except ScenecError as error:
                drawn.refusals[backend, case.name] = str(error)
        passes = PASSES if backend == "annotation" else ("rgb", *PASSES)
        others = [f"{case.name}_eye" for case in CASES if case not in limited]
        render(out, backend, spp=SPP, passes=passes, cameras=others)
        if limited:
            names = [f"{case.name}_eye" for case in limited]
            render(out, "annotation", passes=PASSES, cameras=names)
        for case in CASES:
            by = "annotation" if case in limited else backend
            stem = frame_stem(batch, by, f"{case.name}_eye", 0)
            drawn.frames[backend, case.name] = read_frame(stem)
        if backend in DRAWING:
            witness(drawn, backend, page.scratch)
    return drawn


def witness(drawn: Drawn, backend: str, folder: Path) -> None:
    """Pixels of each case of which a renderer itself sees another face or object than exact."""
    caster, cameras = ExactCaster(drawn.scene), drawn.scene.cameras[0]
    (batch,) = find_batches(drawn.folder)
    told = ask(batch, RenderPlan(backend, ("rgb",)), [(0, i) for i in range(len(cameras))])
    for camera, seen in zip(cameras, told, strict=True):
        found = Witness()
        if seen is not None:
            found.add(caster, camera_rays(camera), seen)
        case = camera.name.removesuffix("_eye")
        drawn.seen[backend, case] = "-" if seen is None else str(found.differing)


def annotation(drawn: Drawn) -> str:
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
    return (
        "## Annotation\n\n"
        "The terrain is the plane z = x/16 − y/32, 512 m × 512 m, with 3,000 stones on it. It "
        f"took {drawn.compile_s:.1f} s to compile with one rig for each case. *Footprint* counts "
        "the pixels where a ray by the lens's formula in 80-bit arithmetic meets the plane and the "
        "frame shows nothing, or the other way round. *Depth* is the largest relative error "
        "against the closed form on ground, in float64 (frames on disk hold float32: 6e-8). For "
        "each "
        "renderer the table has the pixels where its own first hit is another face or object "
        "than the exact one → the values of all passes of its frame that differ from the "
        "annotation; *-* means that it cannot follow such rays.\n\n"
        + table(["case", "pixels", "ground seen", "footprint wrong", "depth", *DRAWING], rows)
        + "\nMost cameras stand over an edge of the mesh: 1 × 1 pixel and half of 20,000 × 1 "
        "pixels look straight at it, where two faces are equally near and the lowest counts.\n"
        + f"\n`scenec check --exact`: {values:,} values of {agreement.frames} frames, "
        f"{agreement.differing} differ.\n"
    )


def _depth_error(
    drawn: Drawn, camera: Camera, parameter: NDArray, where: NDArray[np.bool_]
) -> float | None:
    """The largest relative error of ray parameters in float64, or None where there is none."""
    if not where.any():
        return None
    caster = ExactCaster(drawn.scene)
    found = caster.cast(camera_rays(camera))[2].reshape(where.shape)
    return float((np.abs(found[where] - parameter[where]) / parameter[where]).max())


def light(drawn: Drawn, folder: Path) -> str:
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
    lines = [
        f"- `{backend}`, {next(c.what for c in CASES if c.name == name)}: `{line}` "
        "Its annotation can be made (`--passes label,depth`); `mitsuba` and `pyrender` draw it."
        for (backend, name), line in drawn.refusals.items()
    ]
    return (
        "## Light\n\n"
        f"{SPP} samples a pixel. *Covered*: by {FINE} × {FINE} exact rays a pixel. For each "
        "renderer the table has: the mean radiance of the pixels that surfaces fill, over "
        "Mitsuba's · the mean coverage · the full or empty pixels whose coverage is neither 1 "
        "nor 0. All radiance is finite unless the table says otherwise. `cycles` and `pyrender` "
        "draw lenses as pinhole views that are resampled, so the rim of an image circle is a "
        "pixel wide there.\n\n"
        + table(["case", "covered", *DRAWING], rows)
        + "\nWhat cannot be drawn, in one line each:\n\n"
        + "\n".join(lines)
        + "\n"
    )


def _mean(part: dict[str, Any], whole: NDArray[np.bool_]) -> float | None:
    return float(part["light"][whole].mean()) if whole.any() else None


def _covered(scene: RenderScene, camera: Camera) -> NDArray[np.float64]:
    """What surfaces fill of each pixel, by a lattice of exact rays, [h, w]."""
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
        radiance, _ = session._radiance(camera, 0, SPP, 1, False, {"seconds": {}}, None)
        found[name] = {"light": radiance.halves.mean(axis=0), "coverage": radiance.coverage}
    return found


def costs(drawn: Drawn) -> str:
    """Seconds and memory."""
    rows = []
    for case in CASES:
        row = [case.what]
        for backend in BACKENDS:
            sidecar = drawn.frames[backend, case.name].sidecar
            seconds = sum(v for k, v in (sidecar.seconds or {}).items() if k != "load")
            row.append(f"{seconds:.2f} s, {sidecar.peak_memory_gb:.2f} GB")
        rows.append(row)
    return (
        "## What a frame cost\n\n"
        "Time for all passes and for writing, without loading the scene, and the worker's peak "
        "memory.\n\n" + table(["case", *BACKENDS], rows)
    )


def near_and_far(page: Page) -> str:
    """Something a centimeter away before something 10,000 km away."""
    stage = near_and_far_stage(page.scratch)
    rows = []
    truth = None
    for backend in BACKENDS:
        report = render(stage, backend, passes=("depth", "instance", "label", "face"))
        frame = read_frame(report.frames[0])
        truth = frame if truth is None else truth
        near, far = (np.isclose(frame.passes["depth"], d, rtol=1e-6, atol=0) for d in (0.01, 1e7))
        after = sum(int((frame.passes[k] != v).sum()) for k, v in truth.passes.items())
        rows.append([f"`{backend}`", str(int(near.sum())), str(int(far.sum())),
                     f"{float(frame.passes['depth'].max() / frame.passes['depth'].min()):.3g}",
                     str(after)])  # fmt: skip
    return (
        "## Near and far in one picture\n\n"
        "One sheet, 1 cm in front of the camera, hides the left half of the picture; another one "
        "is 10,000 km behind it. The scene is a USD file without a cfg. A usual depth buffer "
        "between 1 cm and 10,000 km keeps no digit of what is far, so `pyrender` draws "
        "reversed float32 depth with its far plane at infinity, and depth itself comes from the "
        "exact caster. `mitsuba` has float32 coordinates around the scene's middle, here 5,000 km "
        "away, whose step is half a meter, so its picture would lose the near sheet. Annotation "
        "does not. Avoid scenes that are "
        "10⁷ times as large as the distance to what their pictures show.\n\n"
        + table(["backend", "pixels at 1 cm", "at 10,000 km", "ratio", "wrong values"], rows)
    )


def poses(page: Page) -> str:
    """Tracks of many poses, and of none to go."""
    count = 100_000
    cfg = many_poses_cfg(page.scratch, count)
    start = time.perf_counter()
    out = compile_cfg(cfg, seed=1, out=page.scratch / "many").out
    compiled = time.perf_counter() - start
    size = sum(f.stat().st_size for f in (out / "batch_0000").rglob("*") if f.is_file())
    start = time.perf_counter()
    last = count - 1
    report = render(out, "annotation", samples=[0, count // 2, last], passes=("depth", "label"))
    rendered = time.perf_counter() - start
    pose = read_frame(report.frames[-1]).sidecar.camera_to_world
    asked = np.loadtxt(page.scratch / "many.csv", delimiter=",")[last, 1:4]
    off = float(np.abs(np.array(pose)[:3, 3] - asked).max())
    return (
        "## Many poses\n\n"
        f"A track of {count:,} poses, each a sample: compiled in {compiled:.1f} s, "
        f"{size / 1e6:.1f} MB of stage; the first, the middle and the last frame rendered in "
        f"{rendered:.1f} s with starting and reading the stage. The last pose in its sidecar is "
        f"off the track's by {off:.0e} m. A track of length 0, sampled at any time, gives its one "
        "pose (`tests/backends/test_extremes.py`). Beyond 256 views pruning uses coarser "
        "horizons, so memory hardly grows.\n"
    )


def sizes(page: Page) -> str:
    """Memory and seconds over picture sizes, in bands and in one piece."""
    cfg = write_cfg(page.scratch, small_cfg(samples=1))
    stage = compile_cfg(cfg, seed=4, out=page.scratch / "sizes").out / "batch_0000" / "stage.usda"
    rows = []
    todo = {"annotation": (512, 2048), "mitsuba": (2048, 4096, 8192)}
    for backend, sides in todo.items():
        for size in sides[:1] if page.fast else sides:
            found = apart(_large, stage, backend, [size, False, page.scratch]).value
            row = [f"`{backend}`", f"{size:,} × {size:,}", str(found["bands"]),
                   f"{found['peak_gb']:.2f}", f"{found['cpu_s']:.0f}"]  # fmt: skip
            if found["bands"] > 1 and backend == "mitsuba":
                whole = apart(_large, stage, backend, [size, True, page.scratch]).value
                assert whole["arrays"] == found["arrays"]
                row += [f"{whole['peak_gb']:.2f}", f"{whole['cpu_s']:.0f}"]
            else:
                row += ["", ""]
            rows.append(row)
    header = ["backend", "pixels", "bands", "peak, GB", "CPU s", "in one piece, GB", "CPU s"]
    return SIZES + table(header, rows)


SIZES = """## Large pictures

Above 2048 × 2048 pixels annotation goes band by band, radiance by tiles of 4 million pixels at most
(`backends/camera/tiles.py`). Annotation is the same to the bit as in one piece: the script
compares digests. Radiance has the noise of other seeds. Passes `label` (two levels), `instance`,
`depth`; the peak is that of the process with interpreter, renderer and scene.

"""


def _large(stage: Path, backend: str, arguments: list[Any]) -> dict[str, Any]:
    size, whole, folder = arguments
    session = Session.open(stage, backend)
    camera = session.scene.cameras[0][0]
    k = camera.intrinsics * (size / camera.width)
    k[1, 2], k[2, 2] = 0.5 * size, 1.0
    camera = replace(camera, width=size, height=size, intrinsics=k)
    passes = session.passes(("label", "instance", "depth"), camera)
    # What the first picture alone costs.
    session.render(tiles.crop(camera, range(16), range(16)), 0, passes, 1, 0)
    if whole:
        tiles.PIXELS = tiles.TALLEST = 1 << 40
    memory.reset_peak()
    start = time.process_time()
    arrays = session.render(camera, 0, passes, 1, 0).arrays
    seconds, peak = time.process_time() - start, memory.peak() or 0
    digests = {name: hashlib.sha256(values).hexdigest() for name, values in arrays.items()}
    write_exr(folder / "large.exr", arrays)
    return {
        "peak_gb": max(peak, memory.peak() or 0) / GB,
        "cpu_s": seconds,
        "bands": len(tiles.bands(camera)),
        "arrays": digests,
    }


def main(page: Page) -> None:
    """Writes the page."""
    drawn = draw_cases(page)
    page.write(HEAD, ("scenec", "numpy", "mitsuba", "bpy", "pyrender-maintained"), [
        lambda _: annotation(drawn), lambda page: light(drawn, page.scratch), near_and_far, sizes,
        poses, lambda _: costs(drawn),
    ])  # fmt: skip


if __name__ == "__main__":
    run(main, page="extremes")
