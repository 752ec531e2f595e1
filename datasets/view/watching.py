"""A page that follows its output: what has changed, and how an open page learns of it.

A page from disk may look into no other file, but load scripts: beside a watched page stands one of
a line, which says which state of the output the page is of. Open pages ask it again and again.
"""

from __future__ import annotations

import hashlib
from pathlib import Path

from scenec.datasets.outputs import find_outputs
from scenec.schemas.files import atomic, stamp
from scenec.schemas.manifest import FRAMES, MANIFEST
from scenec.schemas.sweep import SWEEP


def state_of(out: Path) -> str:
    """A digest of what a page shows: manifest, stages and sidecars of frames, by size and time.

    Sidecars come last of a frame's files, so half a frame is no change.
    """
    outputs = find_outputs(out)
    files = [out / SWEEP] if outputs.points else []
    files += [folder / MANIFEST for folder in outputs.folders if folder.is_dir()]
    for batch in outputs.find():
        files += [batch.stage, *sorted((batch.folder / FRAMES).glob("*/*/*.json"))]
    found = hashlib.sha256()
    for file in files:
        try:
            told = stamp(file)
        except FileNotFoundError:
            # Between two steps of who replaces it.
            continue
        found.update(f"{file}\0{told}\n".encode())
    return found.hexdigest()[:16]


def sign_of(page: Path) -> Path:
    """The script beside a page."""
    return page.with_name(f"{page.name}.watch.js")


def write_sign(page: Path, state: str) -> None:
    """Says which state the page is of."""
    with atomic(sign_of(page)) as temporary:
        temporary.write_text(f'window.scenecState = "{state}";\n', encoding="ascii")
