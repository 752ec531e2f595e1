"""Checks of the files on disk against the manifest."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from scenec.backends.check.finding import Finding
from scenec.schemas.errors import OutputError
from scenec.schemas.files import inside, sha256, tree
from scenec.schemas.manifest import FRAMES, MANIFEST, RECTIFIED, TIMINGS, Manifest, gaps
from scenec.schemas.scans import SCANS

_NOT_IN_MANIFEST = (TIMINGS, MANIFEST)


def check_files(out: Path, manifest: Manifest) -> Iterator[Finding]:
    """Every file of the manifest is there with its bytes; what is not in it is named."""
    for name, entry in manifest.files.items():
        try:
            path = inside(out, name)
        except OutputError as error:
            yield Finding("files", "error", name, str(error))
            continue
        if not path.is_file():
            yield Finding("files", "error", name, "is in the manifest but not on disk")
        elif sha256(path) != entry.sha256:
            yield Finding("files", "error", name, "its bytes are not those of the manifest")
    for line in gaps(manifest):
        yield Finding("files", "warning", "manifest", line)
    batches = {batch.path for batch in manifest.batches}
    for path in tree(out):
        name = path.as_posix()
        rendered = len(path.parts) > 2 and path.parts[1] in (FRAMES, RECTIFIED, SCANS)
        frame = rendered and path.parts[0] in batches
        if name in manifest.files or name in _NOT_IN_MANIFEST or frame:
            continue
        if path.parts[0].startswith("batch_"):
            yield Finding("files", "warning", name, "is not in the manifest")
