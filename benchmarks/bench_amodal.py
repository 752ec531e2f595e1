"""What amodal areas and masks cost beside the rest of annotation: prints a table.

    NUMBA_NUM_THREADS=1 python benchmarks/bench_amodal.py [CFG]

First the frames of a cfg (default: configs/jacksboro.json), then scenes of its kind with about 100,
1,000 and 13,000 instances in sight. *cast* makes labels,
ids and depth. *table* is the table of
instances without amodal columns; *areas* and *masks* are what the columns, and the masks on top of
them, add. Shares are of cast and table together: of annotation as it was without them. Each
number is processor time, the least of a few rounds, and one process measures all; with several
threads it counts the time that they wait for each other, too.
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests" / "backends"))
import scenes

from scenec.backends.annotation.annotate import annotate
from scenec.backends.annotation.instances import Instances
from scenec.backends.annotation.outlines import Silhouettes
from scenec.backends.camera.rays import camera_rays
from scenec.backends.exact import ExactCaster
from scenec.backends.stage.read import read_stage
from scenec.backends.stage.scene import Camera, RenderScene
from scenec.compiler.compile import compile_cfg

ROOT = Path(__file__).resolve().parent.parent
PASSES = ("label", "instance", "depth")
ROUNDS = 3
#: Rocks, meters of the camera above the ground: about 100, 1,000 and 13,000 are in sight.
CROWDS = ((500, 1.7), (3500, 5.0), (65000, 35.0))


def best(function: Callable[[], Any]) -> float:
    """Least processor seconds of a few calls; the first, which may compile, does not count."""
    function()
    seconds = []
    for _ in range(ROUNDS):
        start = time.process_time()
        function()
        seconds.append(time.process_time() - start)
    return min(seconds)


def measure(what: str, scene: RenderScene, views: list[tuple[int, Camera]]) -> None:
    """Print a line: sums over views."""
    caster, instances = ExactCaster(scene), Instances(scene)
    outliner = instances._outliner
    total = np.zeros(4)
    seen = pixels = amodal = full = bytes_of_masks = 0
    for sample, camera in views:
        caster.pose(sample)
        exact = caster.hits(camera_rays(camera))

        def cast(camera: Camera = camera, sample: int = sample) -> None:
            annotate(scene, caster, camera, PASSES, sample)

        def table(
            masks: bool, exact: Any = exact, camera: Camera = camera, sample: int = sample
        ) -> Any:
            return instances.seen(exact.row, exact.t, camera, sample, exact.geometry, masks)

        found = table(True)
        own = outliner.outline

        def nothing(*arguments: Any) -> Silhouettes:
            zero = np.zeros(len(arguments[3]), np.int64)
            return Silhouettes(zero, zero, zero > 0)

        outliner.outline = nothing  # type: ignore[method-assign, assignment]
        plain = best(lambda: table(False))
        outliner.outline = own  # type: ignore[method-assign]
        with_areas, with_masks = best(lambda: table(False)), best(lambda: table(True))
        total += best(cast), plain, with_areas - plain, with_masks - with_areas
        seen += len(found.table["id"])
        pixels += int(found.table["pixels"].sum())
        amodal += int(found.table["amodal"].sum())
        full += int(found.table["amodal_full"].sum())
        bytes_of_masks += found.amodal.counts.nbytes + found.amodal.starts.nbytes
    count = len(views)
    before = total[0] + total[1]
    milliseconds = "".join(f"{1e3 * value / count:9.1f}" for value in total)
    shares = "".join(f"{value / before:9.1%}" for value in total[2:])
    print(
        f"{what:22}{seen / count:8.0f}{milliseconds}{shares}"
        f"{1 - pixels / max(amodal, 1):10.1%}{1 - amodal / max(full, 1):10.1%}"
        f"{bytes_of_masks / count / 1e3:9.1f}",
        flush=True,
    )


def main() -> None:
    """Print the table."""
    cfg = Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT / "configs" / "jacksboro.json"
    print("milliseconds a frame of 640 x 480; share of annotation; what is hidden, cut off; kB")
    print(
        f"{'scene':22}{'seen':>8}{'cast':>9}{'table':>9}{'areas':>9}{'masks':>9}{'areas':>9}"
        f"{'masks':>9}{'occluded':>10}{'truncated':>10}{'masks':>9}"
    )
    with tempfile.TemporaryDirectory() as folder:
        out = compile_cfg(cfg, seed=1, out=Path(folder) / "out").out
        scene = read_stage(out / "batch_0000" / "stage.usda")
        views = [(s, camera) for s, of_sample in enumerate(scene.cameras) for camera in of_sample]
        measure(cfg.stem, scene, views)
    for rocks, height in CROWDS:
        scene = scenes.rocky(rocks, 200, 60.0, subdivisions=2)
        views = []
        for camera in scene.cameras[0][:2]:
            pose = camera.camera_to_world
            eye = pose[:3, 3] + [0.0, 0.0, height - 1.7]
            # At what it looked at before, ten meters ahead, or farther from higher up.
            ahead = pose[:3, 3] + pose[:3, 2] * max(10.0, 0.6 * height)
            views.append((0, scenes.camera(640, 480, 65.0, eye, ahead)))
        measure(f"{rocks:,} rocks", scene, views)


if __name__ == "__main__":
    main()
