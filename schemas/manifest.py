"""The manifest of an output folder: what was compiled, and the hash of every file."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from scenec.schemas.errors import OutputError, StageError

MANIFEST = "manifest.json"
MANIFEST_FORMAT = 1
#: Endings of a path that is a stage itself.
STAGE_SUFFIXES = (".usda", ".usdc", ".usd", ".usdz")


def read_manifest(out: Path) -> dict[str, Any]:
    """The manifest of an output folder.

    Raises:
        OutputError: There is none, or it is none.
    """
    path = out / MANIFEST
    if not path.is_file():
        raise OutputError(f"{out}: holds no {MANIFEST}; compile a cfg into it first")
    try:
        manifest = json.loads(path.read_text(encoding="utf-8"))
        for batch in manifest["batches"]:
            str(batch["stage"]), str(batch["path"])
        manifest["files"].items()
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise OutputError(f"{path}: is no scenec manifest") from error
    return manifest


@dataclass(frozen=True)
class Batch:
    """A stage to render and the folder its frames go to (below ``frames/``)."""

    name: str
    stage: Path
    folder: Path


def find_batches(out: Path, batches: range | None = None) -> list[Batch]:
    """The stages of an output folder, or the one stage of a USD file.

    Raises:
        OutputError: No manifest.
        StageError: None of the batches asked for is there.
    """
    if out.suffix.lower() in STAGE_SUFFIXES and not out.is_dir():
        if not out.is_file():
            raise StageError(f"{out}: no such file")
        return [Batch(out.stem, out, out.parent)]
    entries: list[dict[str, Any]] = read_manifest(out)["batches"]
    found = [
        Batch(str(entry["path"]), out / entry["stage"], out / entry["path"])
        for i, entry in enumerate(entries)
        if batches is None or entry.get("index", i) in batches
    ]
    if not found:
        raise StageError(f"{out}: holds none of the batches asked for (it has {len(entries)})")
    return found
