"""pyrender on a compiled cfg: seconds a frame, with and without culling, and beside a bare script.

    python studies/benchmarks/pyrender_adapter.py [--cfg CFG | --out OUT] [--spp N] [--rounds N]

The witness is what pyrender itself sees, row and face of each pixel; the preview is its radiance.
Everything is loaded, and what is timed is what each further frame costs; the columns are medians
and the worst of all samples and rounds. The bare script is what pyrender's ways would have one
write: a primitive with instances' poses for each mesh, a program of its own for ids, one call each,
all of the scene. It is asked in turns with the adapter, without culling first (the same work) and
with it; the table gives medians of the paired ratios. With ``--out``, an output that Mitsuba has
rendered, pictures are compared with Mitsuba's by FLIP.
"""

from __future__ import annotations

import argparse
import ctypes
import os
import statistics
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.backends.camera.rays import camera_rays
from scenec.backends.picture.compose import compose
from scenec.backends.pyrender import Pyrender
from scenec.backends.pyrender.camera import camera_view
from scenec.backends.stage.read import read_stage
from scenec.backends.stage.scene import Camera, RenderScene
from scenec.compiler.compile import compile_cfg
from scenec.schemas.frames import frame_stem, read_frame
from scenec.schemas.picture import develop

ROOT = Path(__file__).resolve().parents[2]

VERTEX = """#version 420 core
layout(location = 0) in vec3 position;
layout(location = 1) in mat4 pose;
uniform mat4 clip;
flat out int instance;
void main()
{
    instance = gl_InstanceID;
    gl_Position = clip * pose * vec4(position, 1.0);
}
"""
FRAGMENT = """#version 420 core
flat in int instance;
uniform int part;
layout(location = 0) out uvec4 id;
void main()
{
    id = uvec4(part + 1, instance, gl_PrimitiveID, 0);
}
"""


class Bare:
    """All of a scene, drawn with pyrender's primitives into integers."""

    def __init__(self, scene: RenderScene, folder: Path) -> None:
        import pyrender
        from OpenGL import GL
        from pyrender.shader_program import ShaderProgramCache

        self.gl = GL
        self.parts = []
        self.rows = []
        for index, mesh in enumerate(scene.meshes):
            rows = np.flatnonzero(scene.rows.mesh == index)
            if len(rows) == 0 or len(mesh.faces) == 0:
                continue
            poses = np.zeros((len(rows), 4, 4), np.float32)
            poses[:, :3] = scene.rows.to_world[rows]
            poses[:, 3, 3] = 1.0
            part = pyrender.Primitive(positions=mesh.points, indices=mesh.faces, poses=poses)
            part._add_to_context()
            self.parts.append(part)
            self.rows.append(rows)
        self.all_rows = np.concatenate(self.rows).astype(np.int32)
        self.first_row = np.cumsum([0, *(len(rows) for rows in self.rows)])
        (folder / "ids.vert").write_text(VERTEX, encoding="utf-8")
        (folder / "ids.frag").write_text(FRAGMENT, encoding="utf-8")
        self.program = ShaderProgramCache(shader_dir=str(folder)).get_program(
            "ids.vert", "ids.frag"
        )
        self.program._add_to_context()
        self.framebuffer = 0

    def _target(self, width: int, height: int) -> None:
        gl = self.gl
        self.framebuffer = gl.glGenFramebuffers(1)
        gl.glBindFramebuffer(gl.GL_FRAMEBUFFER, self.framebuffer)
        for attachment, kind in (
            (gl.GL_COLOR_ATTACHMENT0, gl.GL_RGBA32UI),
            (gl.GL_DEPTH_ATTACHMENT, gl.GL_DEPTH_COMPONENT32F),
        ):
            buffer = gl.glGenRenderbuffers(1)
            gl.glBindRenderbuffer(gl.GL_RENDERBUFFER, buffer)
            gl.glRenderbufferStorage(gl.GL_RENDERBUFFER, kind, width, height)
            gl.glFramebufferRenderbuffer(gl.GL_FRAMEBUFFER, attachment, gl.GL_RENDERBUFFER, buffer)

    def visibility(self, camera: Camera) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
        """Row and face of each pixel."""
        from OpenGL.GL.ARB.clip_control import glClipControl
        from OpenGL.raw.GL.VERSION.GL_1_1 import glReadPixels

        gl = self.gl
        if not self.framebuffer:
            self._target(camera.width, camera.height)
        view, _ = camera_view(camera, 1e3, 0, camera.height)
        away = np.eye(4)
        away[:3, 3] = -view.origin
        gl.glBindFramebuffer(gl.GL_FRAMEBUFFER, self.framebuffer)
        gl.glViewport(0, 0, camera.width, camera.height)
        glClipControl(gl.GL_LOWER_LEFT, gl.GL_ZERO_TO_ONE)
        gl.glEnable(gl.GL_DEPTH_TEST)
        gl.glDepthFunc(gl.GL_GREATER)
        gl.glClearDepth(0.0)
        gl.glClear(gl.GL_DEPTH_BUFFER_BIT)
        gl.glClearBufferuiv(gl.GL_COLOR, 0, np.zeros(4, np.uint32))
        self.program._bind()
        self.program.set_uniform("clip", (view.clip @ away).astype(np.float32))
        for index, part in enumerate(self.parts):
            self.program.set_uniform("part", index)
            part._bind()
            gl.glDrawElementsInstanced(
                gl.GL_TRIANGLES, part.indices.size, gl.GL_UNSIGNED_INT, ctypes.c_void_p(0),
                len(part.poses),
            )  # fmt: skip
            part._unbind()
        out = np.empty((camera.height, camera.width, 4), np.uint32)
        pointer = out.ctypes.data_as(ctypes.c_void_p)
        glReadPixels(
            0, 0, camera.width, camera.height, gl.GL_RGBA_INTEGER, gl.GL_UNSIGNED_INT, pointer
        )
        found = out.reshape(-1, 4)
        hit = np.flatnonzero(found[:, 0])
        row = np.full(len(found), -1, np.int32)
        face = np.zeros(len(found), np.int32)
        row[hit] = self.all_rows[self.first_row[found[hit, 0] - 1] + found[hit, 1]]
        face[hit] = found[hit, 2]
        return row, face


def timed(work: Callable[[], Any]) -> tuple[float, Any]:
    """Seconds, and what came of it."""
    start = time.perf_counter()
    result = work()
    return time.perf_counter() - start, result


def frames(scene: RenderScene, spp: int, rounds: int, culling: bool) -> None:
    """Prints seconds of each step, medians and the worst over all samples and rounds but one."""
    backend = Pyrender(culling=culling)
    load, _ = timed(lambda: backend.load(scene))
    first, _ = timed(lambda: backend.radiance(scene.cameras[0][0], 0, spp, 0))
    seconds: dict[str, list[float]] = {"witness": [], "preview": []}
    for turn in range(rounds + 1):
        for sample, cameras in enumerate(scene.cameras):
            camera = cameras[0]
            rays = camera_rays(camera)
            see, _ = timed(lambda r=rays, s=sample, c=camera: backend.witness(r, s, c))
            preview, _ = timed(lambda s=sample, c=camera: backend.radiance(c, s, spp, 0))
            if turn:
                seconds["witness"].append(see)
                seconds["preview"].append(preview)
    cells = "".join(
        f"{statistics.median(column):9.3f}{max(column):7.3f}" for column in seconds.values()
    )
    name = "with culling" if culling else "without"
    print(f"{name:14}{cells}{load:7.2f}{first:9.2f}")


def beside_bare(scene: RenderScene, rounds: int) -> None:
    """Prints the median of the paired ratios of the adapter's visibility to the bare script's."""
    with tempfile.TemporaryDirectory() as folder:
        bare = Bare(scene, Path(folder))
    for culling in (False, True):
        backend = Pyrender(culling=culling)
        backend.load(scene)
        ratios, times = [], []
        for turn in range(rounds + 1):
            for sample, cameras in enumerate(scene.cameras):
                camera = cameras[0]
                rays = camera_rays(camera)
                ours, _ = timed(lambda r=rays, s=sample, c=camera: backend.witness(r, s, c))  # noqa: B023
                theirs, _ = timed(lambda c=camera: bare.visibility(c))
                if turn:
                    ratios.append(ours / theirs)
                    times.append(theirs)
        print(
            f"visibility {'with' if culling else 'without'} culling / bare script "
            f"({statistics.median(times):.3f} s): {statistics.median(ratios):.3f}"
        )


def compare(out: Path, scene: RenderScene, spp: int) -> None:
    """Prints FLIP and the ratio of mean radiance to Mitsuba's frames, where there are any."""
    try:
        import flip_evaluator
    except ImportError:
        print("FLIP: pip install 'scenec[flip]'")
        return
    backend = Pyrender()
    backend.load(scene)
    for sample, cameras in enumerate(scene.cameras):
        camera = cameras[0]
        stem = frame_stem(out / "batch_0000", "mitsuba", camera.name, sample)
        if not stem.with_suffix(".exr").is_file():
            print(f"sample {sample}: no frame of Mitsuba at {stem}")
            continue
        theirs = read_frame(stem.with_suffix(".exr"), ("rgb",)).passes["rgb"]
        ours = compose(backend.radiance(camera, sample, spp, 0), scene, camera, sample).rgb
        pictures = [develop(p, camera.exposure_ev).astype(np.float32) / 255 for p in (theirs, ours)]
        flip = flip_evaluator.evaluate(*pictures, "LDR")[1]
        ratio = ours.mean(axis=(0, 1)) / theirs.mean(axis=(0, 1))
        print(f"sample {sample}: FLIP {flip:.4f}, mean radiance {np.round(ratio, 4)} of Mitsuba's")


def main() -> None:
    """Prints the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cfg", type=Path, default=ROOT / "configs" / "jacksboro.json")
    parser.add_argument("--out", type=Path, help="compiled, perhaps rendered by Mitsuba")
    parser.add_argument("--spp", type=int, default=4)
    parser.add_argument("--rounds", type=int, default=3)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        out = arguments.out
        if out is None:
            out = compile_cfg(arguments.cfg, seed=1, out=Path(folder) / "out").out
        scene = read_stage(out / "batch_0000" / "stage.usda")
        print(f"{Pyrender().version()}, {os.cpu_count()} cores, {arguments.spp} samples a pixel")
        heads = ("witness", "preview")
        print(f"{'':14}{''.join(f'{head:>9.9}  worst' for head in heads)}   load    first")
        for culling in (True, False):
            frames(scene, arguments.spp, arguments.rounds, culling)
        beside_bare(scene, arguments.rounds)
        if arguments.out is not None:
            compare(out, scene, arguments.spp)


if __name__ == "__main__":
    main()
