"""Compares what adapters cost with bare scripts of the same renderers on the same stage.

    python lab/benchmarks/adapters.py [--backends A,B] [--cfg FILE | --stage FILE] [--spp N]
                                          [--rounds N] [--fast]
    python lab/benchmarks/adapters.py --shipped [NAME,NAME] [--backends A,B] [--spp N]
                                          [--width N] [--rounds N] [--fast]

Two processes hold the same stage's arrays: one the adapter, one a script as the renderer's
documentation would have one write (``bare_*.py`` here). They are asked in turns, so that a busy
machine is busy for both; the table has medians and medians of the paired ratios. The witness is
what Cycles sees, row and face of each pixel. Radiance has new light for each picture; where the
mean of what the two draw differs by more than 2 %, the table compares different pictures, and the
status is 2. Blender's script knows no maps, no metals, no haze, no lamps, nothing that moves: there
both draw without.

With ``--shipped`` the cfgs that ship, CPU seconds: of the first frame (loading and drawing) and of
each further one, their ratio to the bare script and to the same scene in plain colors, and the
error that the halves state. Of Cycles it is the plain scene that is beside the script.
"""

from __future__ import annotations

import importlib
import os
import statistics
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from scenec.backends.camera.rays import camera_rays
from scenec.backends.contract import Radiance
from scenec.backends.picture.noise import estimate
from scenec.backends.registry import open_backend
from scenec.backends.stage.read import read_stage
from scenec.backends.stage.scene import Camera, RenderScene
from scenec.lab.runner import CONFIGS, DEMO, Cell, Cost, Study, held, names, peak_mib, run
from scenec.schemas.errors import ScenecError


class Adapter:
    """A backend, with the methods of a bare script."""

    def __init__(self, scene: RenderScene, backend: str) -> None:
        self.scene: RenderScene = scene
        self.drawn: Radiance | None = None
        self.backend = open_backend(backend)

    def load(self) -> None:
        """Build the scene."""
        self.backend.load(self.scene)

    def witness(self, sample: int) -> None:
        """Row and face of each pixel."""
        camera = self.scene.cameras[sample][0]
        self.backend.witness(camera_rays(camera), sample, camera)

    def radiance(self, sample: int, spp: int, seed: int) -> float:
        """One picture; its mean."""
        camera = self.scene.cameras[sample][0]
        self.drawn = self.backend.radiance(camera, sample, spp, seed)
        return float(self.drawn.halves.mean())

    def stated(self) -> float:
        """The last picture's error, as its halves state it."""
        assert self.drawn is not None
        halves = self.drawn.halves.astype(np.float64)
        return estimate(halves, self.drawn.coverage > 0.0).relative_rms or 0.0


#: Of a process that was told to ``hold``.
_made: Any = None


def hold(
    backend: str, stage: Path, bare: bool, plain: bool = False, width: int | None = None
) -> int:
    """Make the adapter or the bare script of a stage; how many samples there are.

    Args:
        backend: Name.
        stage: File.
        bare: Whether it is the script.
        plain: Whether to leave maps out; Cycles without a width draws what its script knows anyway.
        width: Of pictures, pixels, if not as the stage says.
    """
    global _made
    # Blender talks on standard output.
    os.dup2(2, 1)
    script = importlib.import_module(f"scenec.lab.benchmarks.bare_{backend}")
    scene = read_stage(stage)
    if width is not None:
        cameras = tuple(tuple(narrowed(camera, width) for camera in each) for each in scene.cameras)
        scene = replace(scene, cameras=cameras)
    if backend == "cycles" and (plain or width is None):
        scene = script.plain(scene)
    elif plain:
        surfaces = tuple(replace(surface, maps=None) for surface in scene.surfaces)
        scene = replace(scene, surfaces=surfaces)
    _made = script.Bare(scene) if bare else Adapter(scene, backend)
    return len(scene.cameras)


def narrowed(camera: Camera, width: int) -> Camera:
    """A camera of the same view with fewer pixels."""
    scale = width / camera.width
    intrinsics = camera.intrinsics * np.array([[scale], [scale], [1.0]])
    height = round(camera.height * scale)
    return replace(camera, width=width, height=height, intrinsics=intrinsics)


def ask(method: str, *arguments: int) -> float | None:
    """Have it do something; a picture's mean, or None."""
    found = getattr(_made, method)(*arguments)
    return found if isinstance(found, float) else None


def rows(study: Study, backend: str, stage: Path) -> Iterator[list[Cell]]:
    """The rows of one renderer."""
    rounds, spp = (2, 4) if study.fast else (study.options.rounds, study.options.spp)

    def compared(
        what: str, both: list[Callable[..., Cost]], arguments: Callable[[int], tuple[Any, ...]]
    ) -> list[Cell]:
        turns = [[one(ask, *arguments(turn)) for one in both] for turn in range(rounds + 1)]
        # The first one compiles and builds what later ones find.
        walls = [[cost.wall_s for cost in pair] for pair in turns[1:]]
        ratio = statistics.median(a / b for a, b in walls)
        cpu = statistics.median(a.cpu_s / b.cpu_s for a, b in turns[1:])
        means = [statistics.mean(pair[who].value or 0.0 for pair in turns[1:]) for who in (0, 1)]
        if abs(means[0] - means[1]) > 0.02 * means[1]:
            raise ScenecError(f"{backend}: the pictures differ: mean radiance {means}")
        middle = (statistics.median(column) for column in zip(*walls, strict=True))
        return [backend, what, *middle, ratio, cpu, *(mean or None for mean in means)]

    with held() as adapter, held() as bare:
        both = [adapter, bare]
        samples = min([one(hold, backend, stage, one is bare).value for one in both])
        loads = [one(ask, "load") for one in both]
        # Others take meshes or a context from the adapter's code: their loading compares nothing.
        if backend == "cycles":
            ratio = loads[0].wall_s / loads[1].wall_s
            yield [backend, "load", *(c.wall_s for c in loads), ratio, None, None, None]
            yield compared("witness", both, lambda turn: ("witness", turn % samples))
        # Mitsuba's script draws sample 0 alone.
        of = samples if backend == "cycles" else 1
        yield compared(
            f"radiance, {spp} spp", both, lambda turn: ("radiance", turn % of, spp, turn)
        )
        peaks = [one(peak_mib).value for one in both]
        yield [backend, "peak, MiB", *peaks, peaks[0] / peaks[1], None, None, None]


def shipped(study: Study, backend: str, name: str, stage: Path) -> list[Cell]:
    """The row of one cfg and one renderer."""
    rounds, spp = (1, 4) if study.fast else (study.options.rounds, study.options.spp)
    width = 64 if study.fast else study.options.width
    with held() as textured, held() as plain, held() as bare:
        three = [textured, plain, bare]
        samples = 1
        for one in three:
            # Blender's script draws the plain scene, Mitsuba's the whole one, and sample 0 alone.
            simple = one is plain or (one is bare and backend == "cycles")
            found = one(hold, backend, stage, one is bare, simple, width).value
            samples = found if backend == "cycles" else 1
        loads = [one(ask, "load").cpu_s for one in three]
        turns = [
            [one(ask, "radiance", turn % samples, spp, turn) for one in three]
            for turn in range(rounds + 1)
        ]
        error = textured(ask, "stated").value
    frames = [[cost.cpu_s for cost in turn] for turn in turns]
    means = np.mean([[cost.value for cost in turn] for turn in turns], axis=0)
    beside = 1 if backend == "cycles" else 0
    if abs(means[beside] - means[2]) > 0.02 * means[2]:
        raise ScenecError(f"{backend}, {name}: the pictures differ: mean radiance {means}")
    steady = statistics.median(each[0] for each in frames[1:])
    over_bare = statistics.median(each[beside] / each[2] for each in frames[1:])
    over_plain = statistics.median(each[0] / each[1] for each in frames[1:])
    first = loads[0] + frames[0][0]
    return [name, backend, spp, first, steady, over_bare, over_plain, f"{100.0 * error:.2f} %"]


def main(study: Study) -> None:
    """Prints the table."""
    if study.options.shipped:
        header = ["cfg", "renderer", "samples", "first frame, CPU s", "further ones"]
        header += ["adapter / bare", "textured / plain", "error"]
        stages = (
            (name, study.batch(CONFIGS / f"{name}.json") / "stage.usda")
            for name in study.options.shipped[: 1 if study.fast else None]
        )
        backends = study.options.backends
        study.table(header, (shipped(study, b, *stage) for stage in stages for b in backends))
        return
    stage = study.options.stage or study.batch(study.options.cfg) / "stage.usda"
    header = ["renderer", "what", "adapter, s", "bare, s", "adapter / bare", "of CPU"]
    header += ["mean radiance, adapter", "bare"]
    study.table(
        header, (row for name in study.options.backends for row in rows(study, name, stage))
    )


if __name__ == "__main__":
    backends = ("mitsuba", "cycles")
    run(main, backends=backends, cfg=DEMO, stage=Path, spp=32, rounds=5, shipped=names, width=640)
