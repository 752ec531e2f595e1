"""The manifest of an output folder: what was compiled, and the hash of every file."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from scenec.schemas.errors import OutputError

MANIFEST = "manifest.json"
MANIFEST_FORMAT = 1


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
