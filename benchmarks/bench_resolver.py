"""Build, cast, settle and annotate on a 30,000-rock scene of 640 x 480: prints a table.

Run: ``python benchmarks/bench_resolver.py [--rocks N] [--repeat K]``. Visibility comes from Mitsuba
(llvm, float32, all rows flattened; rocks of 320 triangles, so that the flat mesh fits in memory)
where it is installed, or else from the exact caster with one pixel in 500 wrong.
"""

from __future__ import annotations

import argparse
import importlib.util
import os
import statistics
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests" / "backends"))
import scenes

from scenec.backends.contract import NO_ROW, Rays, Visibility
from scenec.backends.exact import ExactCaster
from scenec.backends.rays import camera_rays
from scenec.backends.render_scene import RenderScene
from scenec.backends.resolver import annotate, settle
from scenec.schemas.threads import at_most

PASSES = ("depth", "label", "instance")
ALL_PASSES = (*PASSES, "range", "normal", "position", "face")


def mitsuba_tracer(scene: RenderScene) -> Callable[[Rays], Visibility] | None:
    """Visibility by Mitsuba's float32 tracer, or None where it is not installed."""
    if importlib.util.find_spec("mitsuba") is None:
        return None
    found = next(Path(np.__file__).parent.parent.glob("llvm_nanobind.libs/libLLVM*"), None)
    if found is None:
        return None
    os.environ.setdefault("DRJIT_LIBLLVM_PATH", str(found))
    import mitsuba as mi

    mi.set_variant("llvm_ad_rgb")
    points, faces, row_of, face_of, count = [], [], [], [], 0
    for row, (which, m) in enumerate(zip(scene.rows.mesh, scene.rows.to_world, strict=True)):
        mesh = scene.meshes[which]
        points.append((mesh.points @ m[:, :3].T + m[:, 3]).astype(np.float32))
        faces.append(mesh.faces + count)
        count += len(mesh.points)
        row_of.append(np.full(len(mesh.faces), row, np.int32))
        face_of.append(np.arange(len(mesh.faces), dtype=np.int32))
    shape = mi.Mesh("flat", count, sum(map(len, faces)))
    parameters = mi.traverse(shape)
    parameters["vertex_positions"] = np.concatenate(points).ravel()
    parameters["faces"] = np.concatenate(faces).astype(np.uint32).ravel()
    parameters.update()
    tracer = mi.load_dict({"type": "scene", "shape": shape})
    rows, locals_ = np.concatenate(row_of), np.concatenate(face_of)

    def trace(rays: Rays) -> Visibility:
        length = np.sqrt((rays.directions**2).sum(axis=1))[:, None]
        hit = tracer.ray_intersect_preliminary(
            mi.Ray3f(
                mi.Point3f(rays.origins.T.astype(np.float32)),
                mi.Vector3f((rays.directions / length).T.astype(np.float32)),
            )
        )
        valid = np.array(hit.is_valid())
        index = np.where(valid, np.array(hit.prim_index), 0)
        return Visibility(
            np.where(valid, rows[index], np.int32(NO_ROW)), np.where(valid, locals_[index], 0)
        )

    return trace


def corrupted(caster: ExactCaster) -> Callable[[Rays], Visibility]:
    """Exact visibility with one pixel in 500 taken from its neighbor."""

    def trace(rays: Rays) -> Visibility:
        row, face, _ = caster.cast(rays)
        wrong = np.arange(len(row)) % 499 == 0
        return Visibility(
            np.where(wrong, np.roll(row, 1), row), np.where(wrong, np.roll(face, 1), face)
        )

    return trace


def timed(function: Callable[..., Any], *arguments: Any) -> tuple[float, Any]:
    """Seconds a call took, and its result."""
    start = time.perf_counter()
    result = function(*arguments)
    return time.perf_counter() - start, result


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--rocks", type=int, default=30000)
    parser.add_argument("--repeat", type=int, default=3)
    arguments = parser.parse_args()

    # The first calls compile or load machine code.
    warm_up = scenes.rocky(20, 20)
    warm_rays = camera_rays(scenes.camera())
    warm_caster = ExactCaster(warm_up)
    warm = settle(warm_caster, warm_rays, corrupted(warm_caster)(warm_rays), None)
    settle(warm_caster, warm_rays, corrupted(warm_caster)(warm_rays), scenes.camera())
    annotate(warm_up, warm, warm_rays, ALL_PASSES)

    full = scenes.rocky(arguments.rocks)
    seconds = [timed(ExactCaster, full) for _ in range(arguments.repeat)]
    caster = seconds[0][1]
    faces = len(caster.geometry.faces)
    print(f"{arguments.rocks} rocks of 1,280 triangles, {faces} triangles stored, 640 x 480")
    print(f"{'build hierarchies':32}{statistics.median(s for s, _ in seconds):8.3f} s")
    for threads in sorted({1, numba.config.NUMBA_NUM_THREADS}):
        spent, count = 0.0, 0
        with at_most(threads):
            for view in full.cameras[0]:
                rays = camera_rays(view)
                spent += timed(caster.cast, rays)[0]
                count += len(rays.origins)
        print(f"{f'cast, {threads} threads':32}{count / spent / 1e6:8.2f} M rays/s")

    scene = scenes.rocky(arguments.rocks, subdivisions=2)
    caster = ExactCaster(scene)
    trace = mitsuba_tracer(scene) or corrupted(caster)
    columns = "visibility  settle  annotate  all passes  suspects  raw wrong  resolved wrong"
    print(f"\n{columns}")
    for view in scene.cameras[0]:
        rays = camera_rays(view)
        trace(rays)
        seen, visibility = timed(trace, rays)
        settling, settled = min(
            (timed(settle, caster, rays, visibility, view) for _ in range(arguments.repeat)),
            key=lambda pair: pair[0],
        )
        some, _ = timed(annotate, scene, settled, rays, PASSES)
        every, _ = timed(annotate, scene, settled, rays, ALL_PASSES)
        row, face, t = caster.cast(rays)
        wrong = (settled.row != row) | (settled.face != face) | (settled.t != t)
        counts = settled.statistics
        print(
            f"{seen:8.3f} s{settling:7.3f} s{some:8.4f} s{every:10.4f} s"
            f"{100 * counts.suspects / counts.pixels:9.1f}%{counts.changed:11d}{wrong.sum():16d}"
        )


if __name__ == "__main__":
    main()
