"""Measures grass of BasisCurves: seconds and memory of reading and annotating it, and its error.

    python lab/benchmarks/curves.py [--fast] [--counts N,N]

Blades of 10 to 40 cm, 4 mm wide, on 10 by 10 m, as pinned B-splines in one prim; a picture of
640 by 480 pixels. Each row is a process of its own.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from pxr import Gf, UsdGeom, Vt

from scenec.backends.run.session import Session
from scenec.backends.stage.read import read_stage
from scenec.backends.stage.tubes import ERROR
from scenec.lab.runner import Cell, Study, apart, names, run
from scenec.testing.foreign_stages import new_stage


def write_grass(file: Path, count: int) -> None:
    """Writes a stage of some blades of grass."""
    rng = np.random.default_rng(1)
    root = np.concatenate([rng.uniform(-5, 5, (count, 2)), np.zeros((count, 1))], axis=1)
    height, lean = rng.uniform(0.1, 0.4, count), rng.normal(0, 0.5, (count, 2))
    t = np.array([0, 1 / 3, 2 / 3, 1])
    across = (lean * height[:, None])[:, None] * (t * t)[:, None]
    up = height[:, None, None] * t[:, None]
    points = (root[:, None] + np.concatenate([across, up], axis=2)).reshape(-1, 3)
    stage = new_stage(file)
    grass = UsdGeom.BasisCurves.Define(stage, "/World/grass")
    grass.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(points.astype(np.float32)))
    grass.CreateCurveVertexCountsAttr(Vt.IntArray.FromNumpy(np.full(count, 4, np.int32)))
    grass.CreateBasisAttr("bspline")
    grass.CreateWrapAttr("pinned")
    widths = np.tile(np.array([0.004, 0.003, 0.002, 0.0], np.float32), count)
    grass.CreateWidthsAttr(Vt.FloatArray.FromNumpy(widths))
    grass.SetWidthsInterpolation("vertex")
    eye = UsdGeom.Camera.Define(stage, "/World/eye")
    eye.AddTranslateOp().Set(Gf.Vec3d(0, -7, 1.5))
    eye.AddRotateXOp().Set(80.0)
    stage.Save()


def read(file: Path) -> tuple[int, str]:
    """Reads; triangles, and what is lost."""
    scene = read_stage(file)
    return len(scene.meshes[0].faces), "; ".join(line.split(":")[0] for line in scene.losses)


def annotate(file: Path) -> None:
    """Reads, and makes depth and instances."""
    scene = read_stage(file)
    Session(scene, None).render(scene.cameras[0][0], 0, ("depth", "instance"), 1, 0)


def main(study: Study) -> None:
    """Prints the table."""
    counts = study.options.counts or ("1000", "10000", "100000")
    rows: list[list[Cell]] = []
    for count in counts[: 1 if study.fast else None]:
        file = study.scratch / f"{count}.usdc"
        write_grass(file, int(count))
        reading, both = apart(read, file), apart(annotate, file)
        triangles, lost = reading.value
        rows.append(
            [f"{int(count):,}", f"{triangles:,}", reading.cpu_s, both.cpu_s - reading.cpu_s,
             both.peak_mib, lost or f"within {100 * ERROR:g} %"]
        )  # fmt: skip
    study.table(["blades", "triangles", "read, CPU s", "annotate", "peak, MiB", "error"], rows)


if __name__ == "__main__":
    run(main, counts=names)
