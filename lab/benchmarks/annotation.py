"""Annotation of a frame, of a lidar and of hidden parts: seconds on the 30,000-rock scene.

    python lab/benchmarks/annotation.py [--cfg FILE] [--fast]

Everything is loaded; what is timed is what each further frame or scan costs, whichever renderer
draws it. The second table has what amodal columns, and masks on top of them, add to the table of
instances, in the scene and in ones of its kind with about 100, 1,000 and 13,000 instances in sight,
in CPU milliseconds: by one thread (``NUMBA_NUM_THREADS=1``), or it counts also the time that
threads wait for each other. Shares are of what annotation takes without either.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from scenec.backends.annotation.annotate import annotate
from scenec.backends.annotation.instances import Instances
from scenec.backends.annotation.lidar import scan
from scenec.backends.annotation.outlines import Silhouettes
from scenec.backends.camera.rays import camera_rays
from scenec.backends.exact import ExactCaster
from scenec.backends.run.session import Session
from scenec.backends.stage.read import read_stage
from scenec.backends.stage.scene import Camera, Lidar, RenderScene
from scenec.compiler.views.needed import Keep
from scenec.lab.runner import DEMO, Cell, Study, run, times
from scenec.testing import scenes

BASIC = ("label", "instance", "depth")
PASSES = (
    ("depth",),
    BASIC,
    (*BASIC, "range", "normal", "position", "face", "amodal"),
    (*BASIC, "normal", "flow", "occlusion", "scene_flow"),
)
#: Rocks, meters of the camera above the ground: about 100, 1,000 and 13,000 are in sight.
CROWDS = ((500, 1.7), (3500, 5.0), (65000, 35.0))


def frames(study: Study, stage: Path) -> Iterator[list[Cell]]:
    """A row for each choice of passes, over all samples; then a scan."""
    session = Session.open(stage, "annotation")
    for wanted in PASSES[:2] if study.fast else PASSES:
        found = []
        for sample, (camera, *_) in enumerate(session.scene.cameras):
            passes = session.passes(wanted, camera)

            def frame(c: Camera = camera, s: int = sample, p: Any = passes) -> object:
                return session.render(c, s, p, 0, 0)

            found.append(times(frame, 1 if study.fast else 4))
        wall = [second for each in found for second in each.wall]
        cpu = [second for each in found for second in each.cpu]
        yield [", ".join(wanted), np.median(wall), max(wall), np.median(cpu)]


def scanned(study: Study, scene: RenderScene) -> list[Cell]:
    """A row: a lidar at the first camera's place."""
    turned = np.array([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])
    to_world = scene.cameras[0][0].camera_to_world @ turned
    beams, azimuths = np.linspace(2.0, -24.8, 64), np.arange(1800) * 0.2
    lidar = Lidar("bench", "/bench", to_world, beams, azimuths, (0.5, 120.0), 0.02, 0.01)
    caster = ExactCaster(scene)
    found = times(lambda: scan(scene, caster, lidar, 0), 1 if study.fast else 7)
    share = 100.0 * np.isfinite(found.value["range"]).mean()
    name = f"scan of 64 x 1,800 rays, {share:.0f} % answered"
    return [name, found.median, max(found.wall), np.median(found.cpu)]


def amodal(what: str, scene: RenderScene, views: list[tuple[int, Camera]]) -> list[Cell]:
    """A row: CPU milliseconds a view, what is hidden and cut off, kB of masks."""
    caster, instances = ExactCaster(scene), Instances(scene)
    outliner, total, tables = instances._outliner, np.zeros(4), []
    own = outliner.outline

    def nothing(*arguments: Any) -> Silhouettes:
        zero = np.zeros(len(arguments[3]), np.int64)
        return Silhouettes(zero, zero, zero > 0)

    for sample, camera in views:
        caster.pose(sample)
        hits = caster.hits(camera_rays(camera))

        def table(
            masks: bool, hits: Any = hits, camera: Camera = camera, sample: int = sample
        ) -> Any:
            return instances.seen(hits.row, hits.t, camera, sample, hits.geometry, masks)

        def cast(camera: Camera = camera, sample: int = sample) -> None:
            annotate(scene, caster, camera, BASIC, sample)

        outliner.outline = nothing  # type: ignore[method-assign, assignment]
        plain = min(times(lambda t=table: t(False), 3).cpu)  # type: ignore[misc]
        outliner.outline = own  # type: ignore[method-assign]
        areas, masks = (min(times(lambda t=table, m=m: t(m), 3).cpu) for m in (False, True))
        total += min(times(cast, 3).cpu), plain, areas - plain, masks - areas
        tables.append(table(True))

    def summed(column: str) -> int:
        return max(sum(int(found.table[column].sum()) for found in tables), 1)

    pixels, visible, full = (summed(name) for name in ("pixels", "amodal", "amodal_full"))
    size = sum(t.amodal.counts.nbytes + t.amodal.starts.nbytes for t in tables)
    count, before = len(views), total[0] + total[1]
    shares = [f"{value / before:.1%}" for value in total[2:]]
    hidden = [f"{1 - pixels / visible:.1%}", f"{1 - visible / full:.1%}"]
    seen = round(sum(len(found.table["id"]) for found in tables) / count)
    return [what, seen, *(1e3 * total / count), *shares, *hidden, size / count / 1e3]


def crowds(study: Study, scene: RenderScene) -> Iterator[list[Cell]]:
    """The rows of the second table."""
    views = [(s, camera) for s, of_sample in enumerate(scene.cameras) for camera in of_sample]
    yield amodal(study.options.cfg.stem, scene, views)
    for rocks, height in CROWDS[:1] if study.fast else CROWDS:
        crowd = scenes.rocky(rocks, 200, 60.0, subdivisions=2)
        views = []
        for camera in crowd.cameras[0][:2]:
            pose = camera.camera_to_world
            eye = pose[:3, 3] + [0.0, 0.0, height - 1.7]
            # At what it looked at before, ten meters ahead, or farther from higher up.
            ahead = pose[:3, 3] + pose[:3, 2] * max(10.0, 0.6 * height)
            views.append((0, scenes.camera(640, 480, 65.0, eye, ahead)))
        yield amodal(f"{rocks:,} rocks", crowd, views)


def main(study: Study) -> None:
    """Prints both tables."""
    # Whole: a lidar in the cfg would have kept all around it.
    stage = study.batch(study.options.cfg, keep=Keep.UNPRUNED) / "stage.usda"
    scene = read_stage(stage)
    header = [f"{study.options.cfg.stem}, passes", "wall s", "worst", "CPU s"]
    study.table(header, [*frames(study, stage), scanned(study, scene)])
    if study.fast:
        first = tuple(cameras[:1] for cameras in scene.cameras[:1])
        scene = dataclasses.replace(scene, cameras=first)
    header = ["scene", "seen", "cast, ms", "table", "areas", "masks", "areas, share"]
    header += ["masks, share", "occluded", "truncated", "masks, kB"]
    study.table(header, crowds(study, scene))


if __name__ == "__main__":
    run(main, cfg=DEMO)
