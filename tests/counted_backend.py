"""Plain but honest backends: one writes a line wherever it is started or given a scene, one the
calls that lead to it.
"""

from __future__ import annotations

import inspect
import os
import time
from pathlib import Path
from types import FrameType

import pytest
from third_party import HERE, Plain

import scenec
from scenec.backends.contract import Radiance
from scenec.backends.stage.scene import Camera, RenderScene

LOG = "SCENEC_TEST_COUNTED"
#: Ends of the names of the files that ``Traced`` writes and waits for.
CALLS, GO_ON = ".calls", ".go_on"


def install(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Make it known, here and in processes started from here; returns what it writes to."""
    info = folder / "site" / "counted-1.0.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: counted\nVersion: 1.0\n")
    entry = "[scenec.backends]\ncounted = counted_backend:Counted\n"
    entry += "traced = counted_backend:Traced\n"
    (info / "entry_points.txt").write_text(entry)
    monkeypatch.syspath_prepend(str(info.parent))
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(info.parent), str(HERE)]))
    monkeypatch.setenv(LOG, str(folder / "counted"))
    return folder / "counted"


def _note(line: str) -> None:
    with Path(os.environ[LOG]).open("a", encoding="utf-8") as file:
        file.write(f"{os.getpid()} {line}\n")


class Counted(Plain):
    """As ``Plain``, and counted."""

    name = "counted"

    def __init__(self, device: str = "auto") -> None:
        super().__init__(device)
        _note("start")

    def load(self, scene: RenderScene) -> None:
        """Build the caster, and note it."""
        _note(f"load {Path(scene.source).parent.name}")
        super().load(scene)


def calls_of(frame: FrameType | None) -> list[str]:
    """Names the functions of scenec that a frame stands in, from the outermost in."""
    found = []
    while frame is not None:
        if frame.f_code.co_filename.startswith(tuple(scenec.__path__)):
            module = frame.f_globals["__name__"]
            if module == "__main__":
                module = frame.f_globals["__spec__"].name
            found.append(f"{module}.{frame.f_code.co_qualname}")
        frame = frame.f_back
    return found[::-1]


class Traced(Plain):
    """As ``Plain``; notes by which calls it is reached, and waits until the test has looked."""

    name = "traced"

    def radiance(
        self, camera: Camera, sample: int, spp: int, seed: int, denoise: bool = False
    ) -> Radiance:
        """Notes its callers, waits, and draws."""
        log = Path(os.environ[LOG])
        written = log.with_suffix(".part")
        written.write_text("\n".join(calls_of(inspect.currentframe())))
        written.rename(log.with_suffix(CALLS))
        while not log.with_suffix(GO_ON).exists():
            time.sleep(0.01)
        return super().radiance(camera, sample, spp, seed, denoise)
