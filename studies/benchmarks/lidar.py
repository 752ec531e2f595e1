"""Lidar and flow on the demo's stage: seconds of a scan, and what comparing frames costs.

    python studies/benchmarks/lidar.py [--cfg configs/jacksboro.json] [--rounds N]

A scan of 64 beams and 1,800 azimuths from the first camera's place, noise included; flow, occlusion
and scene flow of a frame beside all of its other annotation, by the reference caster.
"""

from __future__ import annotations

import argparse
import statistics
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from scenec.backends.annotation.lidar import scan
from scenec.backends.exact import ExactCaster
from scenec.backends.run.session import Session
from scenec.backends.stage.read import read_stage
from scenec.backends.stage.scene import Lidar
from scenec.compiler.compile import compile_cfg
from scenec.compiler.passes.keep import Keep

ROOT = Path(__file__).resolve().parents[2]
_ANNOTATION = ("depth", "label", "instance", "normal")


def timed(work: Callable[[], object], rounds: int) -> tuple[float, float]:
    """Median wall and CPU seconds, after one round to warm up."""
    work()
    walls, cpus = [], []
    for _ in range(rounds):
        wall, cpu = time.perf_counter(), time.process_time()
        work()
        walls.append(time.perf_counter() - wall)
        cpus.append(time.process_time() - cpu)
    return statistics.median(walls), statistics.median(cpus)


def main() -> None:
    """Prints a line a number."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cfg", type=Path, default=ROOT / "configs" / "jacksboro.json")
    parser.add_argument("--rounds", type=int, default=7)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        # Whole: a lidar in the cfg would have kept all around it.
        compile_cfg(options.cfg, seed=1, out=folder, batches=range(1), keep=Keep.UNPRUNED)
        scene = read_stage(Path(folder) / "batch_0000" / "stage.usda")
    camera = scene.cameras[0][0]
    turned = np.array([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])
    lidar = Lidar(
        "bench",
        "/bench",
        camera.camera_to_world @ turned,
        np.linspace(2.0, -24.8, 64),
        np.arange(1800) * 0.2,
        (0.5, 120.0),
        range_noise_m=0.02,
        dropout=0.01,
    )
    start = time.perf_counter()
    caster = ExactCaster(scene)
    built = time.perf_counter() - start
    made = scan(scene, caster, lidar, 0)
    wall, cpu = timed(lambda: scan(scene, caster, lidar, 0), options.rounds)
    share = 100.0 * np.isfinite(made["range"]).mean()
    print(f"building the caster, once a batch      {built:7.3f} s")
    print(f"scan, 64 x 1,800 ({share:.0f} % answered)      {wall:7.3f} s  {cpu:7.3f} CPU s")
    session = Session(scene, None)
    for name, passes in (
        ("annotation", _ANNOTATION),
        ("and flow, occlusion, scene flow", (*_ANNOTATION, "flow", "occlusion", "scene_flow")),
    ):
        wall, cpu = timed(
            lambda asked=passes: session.render(camera, 0, session.passes(asked, camera), 1, 0),
            options.rounds,
        )
        size = f"{camera.width} x {camera.height}"
        print(f"{name + ', ' + size:46} {wall:7.3f} s  {cpu:7.3f} CPU s")


if __name__ == "__main__":
    main()
