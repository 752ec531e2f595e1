"""A format of its own, as another package would bring one: for tests of what all formats share."""

from __future__ import annotations

import json
import os
import signal
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import ClassVar

import pytest

from scenec.datasets.formats.contract import Done, Format, Option, Task, Written
from scenec.datasets.source import LoadedFrame
from scenec.schemas.files import write_json

#: Variable of the environment: the frame (``FrameRef.key``) whose writing kills the process.
KILL = "TINY_FORMAT_KILL"


class Tiny(Format):
    """A JSON file a frame, with the ids of its instances, and one of all frames."""

    name: ClassVar[str] = "tiny"
    summary: ClassVar[str] = "for tests"
    needs: ClassVar[tuple[str, ...]] = ("instance",)
    unused: ClassVar[tuple[str, ...]] = ("rgb", "depth")
    options: ClassVar[Mapping[str, Option]] = {
        "ending": Option("json", "ending of file names", ("json", "txt")),
    }

    def write(
        self, task: Task, frames: Iterable[LoadedFrame], folder: Path, scratch: Path
    ) -> Written:
        """A file a frame."""
        written = Written()
        for frame in frames:
            if os.environ.get(KILL) == frame.ref.key:
                os.kill(os.getpid(), signal.SIGKILL)
            name = f"{task.split}/{frame.ref.key}.{self.option('ending')}"
            write_json(
                folder / name,
                {
                    "ids": frame.table["id"].tolist(),
                    "ignored": frame.ignored.tolist(),
                    "labels": frame.labels,
                    "pixels": int((frame.passes["instance"] > 0).sum()),
                },
            )
            written.files.append(name)
            written.record[frame.ref.name] = len(frame.table["id"])
        return written

    def finish(self, done: Iterable[Done], folder: Path, scratch: Path) -> list[str]:
        """How many instances each frame has."""
        counts = {name: n for entry in done for name, n in (entry.record or {}).items()}
        write_json(folder / "all.json", counts)
        return ["all.json"]

    def usage(self) -> str:
        """With YAML for the card's head."""
        return '---\nconfigs:\n- config_name: "all"\n---\nRead `all.json`.\n'


def counts_of(dataset: Path) -> dict[str, int]:
    """What ``finish`` wrote."""
    found: dict[str, int] = json.loads((dataset / "all.json").read_text())
    return found


def install(monkeypatch: pytest.MonkeyPatch, folder: Path) -> Path:
    """Offer the format as an installed package would, to this process and those it starts.

    Returns:
        A folder for PYTHONPATH.
    """
    plugin = folder / "plugin"
    info = plugin / "tiny_format-1.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: tiny-format\nVersion: 1\n")
    (info / "entry_points.txt").write_text("[scenec.exporters]\ntiny = tiny_format:Tiny\n")
    (plugin / "tiny_format.py").write_text(Path(__file__).read_text(encoding="utf-8"))
    monkeypatch.syspath_prepend(str(plugin))
    monkeypatch.setenv("PYTHONPATH", str(plugin), prepend=os.pathsep)
    return plugin


def contents(folder: Path) -> dict[str, bytes]:
    """Bytes of all files below a folder."""
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }
