"""A plain but honest backend that writes a line wherever it is started or given a scene."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from third_party import HERE, Plain

from scenec.backends.stage.scene import RenderScene

LOG = "SCENEC_TEST_COUNTED"


def install(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Make it known, here and in processes started from here; returns what it writes to."""
    info = folder / "site" / "counted-1.0.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: counted\nVersion: 1.0\n")
    entry = "[scenec.backends]\ncounted = counted_backend:Counted\n"
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
